"""The signal of a multirotor: harmonics of each rotor's blade passing frequency, and broadband noise of the blades."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import firwin

from av_common.config_reader import bounded
from av_sim_bridge.vehicle import GRAVITY
from av_simulator.sound.stream import CHUNK, SIGNAL_CHUNKS, Stream, Wander, db_to_ratio, filtered, spl_to_pascal, white_noise
from av_simulator.trajectories import Position, acceleration

_TABLE = 8192  # points of a waveform table, for one revolution of a rotor
_STEPS = 128  # steps of the integration of the rotor speeds in a chunk
_FASTEST = 1.6  # maximum speed relative to rotor_hz without aliasing of harmonics


def rotor_speed(position: Position, times: NDArray) -> NDArray:
    """Rotor speeds (k, 1) relative to hovering at times (s, (k,)), for the trajectory of a source.

    The thrust, proportional to the square of the speed (actuator disk theory), is the force for weight and acceleration.
    """
    thrust = np.linalg.norm(acceleration(position, times) + np.array([0.0, 0.0, GRAVITY]), axis=1)
    return np.sqrt(thrust / GRAVITY)[:, np.newaxis].clip(0.5, 1.5)


@dataclass(frozen=True)
class RotorSignal:
    """Signal of several rotors. Levels are those of the whole vehicle at 1 m. Raises ValueError for impossible values.

    Parameters:
        rotor_hz (Hz): speed of each rotor while hovering (revolutions per second).
        blades: number of blades of a rotor.
        tone_db_spl (dB SPL): level of the tones.
        harmonics_db (dB): harmonics of the blade passing frequency, relative to the first.
        rolloff_db (dB): decrease of each further harmonic.
        harmonics: number of harmonics.
        imbalance_db (dB): multiples of the rotor frequency below the blade passing frequency, from imbalance.
        jitter: relative RMS variation of each rotor's speed by turbulence.
        jitter_hz (Hz): highest frequency of this variation.
        broadband_db_spl (dB SPL): level of the broadband noise.
        broadband_hz (Hz): band of the broadband noise.
        modulation: depth of the noise's amplitude modulation at the blade passing frequency.
    """

    rotor_hz: Sequence[float] = bounded((92.0, 94.5, 90.5, 96.0), above=0.0, high=1000.0, longest=32)
    blades: int = bounded(2, low=1, high=20)
    tone_db_spl: float = bounded(72.0, low=-200.0, high=200.0)
    harmonics_db: Sequence[float] = bounded((0.0, -3.0, -6.0, -7.0, -9.0, -11.0), low=-200.0, high=200.0)
    rolloff_db: float = bounded(1.0, low=0.0, high=200.0)
    harmonics: int = bounded(30, low=1, high=1000)
    imbalance_db: float = bounded(-20.0, low=-200.0, high=200.0)
    jitter: float = bounded(0.004, low=0.0, high=0.1)
    jitter_hz: float = bounded(12.0, above=0.0, high=1000.0)
    broadband_db_spl: float = bounded(70.0, low=-200.0, high=200.0)
    broadband_hz: tuple[float, float] = bounded((400.0, 7000.0), above=0.0, high=1e6)
    modulation: float = bounded(0.3, low=0.0, high=1.0)

    def __post_init__(self) -> None:
        if not self.rotor_hz or not self.harmonics_db:
            raise ValueError('rotor_hz or harmonics_db is empty, expected one rotor and one harmonic at least')
        if self.blades * self.harmonics > _TABLE // 2:
            raise ValueError(f'harmonics is {self.harmonics}, expected at most {_TABLE // 2} over {self.blades} blades')
        if not self.broadband_hz[0] < self.broadband_hz[1]:
            raise ValueError(f'broadband_hz is {self.broadband_hz}, expected two increasing positive frequencies')

    def stream(self, sample_rate: int, key: Sequence[int], position: Position) -> Stream:
        """See SourceSignal; the rotors turn as the source's manoeuvres need."""
        turns = _Turns(self, position, sample_rate, key)
        waveforms = self._waveforms(sample_rate, np.random.default_rng([*key, 1]))
        low, high = self.broadband_hz
        shape = firwin(255, [low, min(high, 0.45 * sample_rate)], pass_zero=False, fs=sample_rate)
        hiss = filtered(white_noise([*key, 2]), shape)
        swell_power = 1.0 + self.modulation**2 / (2.0 * len(self.rotor_hz))
        gain = spl_to_pascal(self.broadband_db_spl) / np.sqrt(np.sum(shape**2) * swell_power)

        def make(index: int) -> NDArray:
            turned = turns.chunk(index)
            fraction = turned - np.floor(turned)
            tone = sum(_look_up(wave, part * _TABLE) for wave, part in zip(waveforms, fraction, strict=True))
            swell = 1.0 + self.modulation * np.cos(2 * np.pi * self.blades * fraction).mean(axis=0)
            return tone + gain * swell * hiss.read(index * CHUNK, (index + 1) * CHUNK)

        return Stream(make, SIGNAL_CHUNKS)

    def _waveforms(self, sample_rate: int, random: np.random.Generator) -> NDArray:
        """Waveforms (Pa at 1 m, (rotors, _TABLE)) of one revolution of each rotor, with random phases of the harmonics."""
        rotors = len(self.rotor_hz)
        listed = np.asarray(self.harmonics_db, float)[:self.harmonics]
        beyond = listed[-1] - self.rolloff_db * np.arange(1, self.harmonics - len(listed) + 1)
        amplitude = np.zeros(_TABLE // 2 + 1)
        amplitude[1:self.blades] = db_to_ratio(self.imbalance_db)
        levels_db = np.concatenate([listed, beyond])
        amplitude[self.blades:self.blades * (self.harmonics + 1):self.blades] = 10.0 ** (levels_db / 20.0)
        amplitude[int(0.45 * sample_rate / (_FASTEST * max(self.rotor_hz))):] = 0.0
        amplitude *= spl_to_pascal(self.tone_db_spl) * np.sqrt(2.0 / (rotors * np.sum(amplitude**2)))
        phase = np.exp(2j * np.pi * random.random((rotors, len(amplitude))))
        return np.fft.irfft(amplitude * phase, axis=-1) * _TABLE / 2.0


def _look_up(wave: NDArray, places: NDArray) -> NDArray:
    """Values of a waveform table (_TABLE,) at places from 0 to _TABLE, by linear interpolation."""
    below = places.astype(int)
    return wave[below] + (places - below) * (np.roll(wave, -1)[below] - wave[below])


class _Turns:
    """Revolutions of each rotor: the integral of its speed from time 0, for positive and negative times in any order."""

    def __init__(self, signal: RotorSignal, position: Position, sample_rate: int, key: Sequence[int]):
        rotors = len(signal.rotor_hz)
        self._signal, self._rate, self._position = signal, sample_rate, position
        self._turbulence = Wander([*key, 0], signal.jitter_hz, rotors)
        self._at_start = {0: np.random.default_rng([*key, 3]).random(rotors)}

    def chunk(self, index: int) -> NDArray:
        """Revolutions (rotors, CHUNK) at the samples of a chunk."""
        places, speeds, turns = self._integrate(index)
        turns = turns + self._start(index)
        spline = CubicHermiteSpline(places[::2], turns, speeds[::2])
        return spline(np.arange(CHUNK) / self._rate + places[0]).T

    def _integrate(self, index: int) -> tuple[NDArray, NDArray, NDArray]:
        """Instants (2 * _STEPS + 1,), their speeds, and revolutions since the first at every second one (Simpson's rule)."""
        places = (index + np.arange(2 * _STEPS + 1) / (2 * _STEPS)) * (CHUNK / self._rate)
        speeds = self._speed(places)
        step = CHUNK / self._rate / _STEPS
        steps = (speeds[:-1:2] + 4.0 * speeds[1::2] + speeds[2::2]) * (step / 6.0)
        return places, speeds, np.concatenate([np.zeros((1, speeds.shape[1])), np.cumsum(steps, axis=0)])

    def _start(self, index: int) -> NDArray:
        way = 1 if index > 0 else -1
        known = index
        while known not in self._at_start:
            known -= way
        for passed in range(known, index, way):
            turned = self._integrate(min(passed, passed + way))[2][-1]
            self._at_start[passed + way] = self._at_start[passed] + way * turned
            forgotten = passed - way * SIGNAL_CHUNKS
            if forgotten % SIGNAL_CHUNKS:    # one in so many stays, to begin from
                self._at_start.pop(forgotten, None)
        return self._at_start[index]

    def _speed(self, times: NDArray) -> NDArray:
        """Speeds (Hz, (k, rotors)) of the rotors at times (s, (k,))."""
        wander = 1.0 + self._signal.jitter * self._turbulence(times)
        return np.asarray(self._signal.rotor_hz) * wander * rotor_speed(self._position, times)
