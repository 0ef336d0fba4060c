"""The signal of a multirotor: harmonics of each rotor's blade passing frequency, and broadband noise of the blades."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import firwin

from av_common.config_reader import bounded
from av_simulator.sound.delays import Position
from av_simulator.sound.levels import db_to_ratio, spl_to_pascal
from av_simulator.sound.stream import CHUNK, SIGNAL_CHUNKS, Stream, filtered, white_noise
from av_simulator.sound.wander import Wander

_TABLE = 8192  # points of a waveform table, for one revolution of a rotor
_MILESTONE = 256  # interval (chunks) of the rotor angles that are kept permanently
_STEPS = 128  # steps of the integration of the rotor speeds in a chunk
_FASTEST = 1.6  # maximum speed relative to rotor_hz without aliasing of harmonics

_GRAVITY = 9.80665
_DRAG_PER_M = 0.017  # 1/m, deceleration over speed squared: a tilt of 35 degrees at 20 m/s
_STEP_S = 0.1  # s, step of the differences for velocity and acceleration, the time scale of a flight controller

Speed = Callable[[NDArray], NDArray]  # times (s, (k,)) -> speeds relative to hovering, (k, rotors) or (k, 1)


def thrust_speed(position: Position) -> Speed:
    """Rotor speed relative to hovering, for the trajectory of a source.

    The thrust, proportional to the square of the speed (actuator disk theory), is the force for weight, acceleration and
    drag. It is limited to 0.25 to 2.5 times the weight.
    """
    def speed(times: NDArray) -> NDArray:
        before, now, after = (position(times + step) for step in (-_STEP_S, 0.0, _STEP_S))
        velocity, acceleration = (after - before) / (2 * _STEP_S), (after - 2.0 * now + before) / _STEP_S**2
        drag = _DRAG_PER_M * velocity * np.linalg.norm(velocity, axis=1, keepdims=True)
        thrust = np.linalg.norm(acceleration + drag + [0.0, 0.0, _GRAVITY], axis=1, keepdims=True) / _GRAVITY
        return np.sqrt(np.clip(thrust, 0.25, 2.5))

    return speed


def _hover(times: NDArray) -> NDArray:
    return np.ones((len(times), 1))


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
        follow: whether the speeds follow the thrust for the source's motion.
        speed: speeds relative to `rotor_hz` as a function of time, None for `follow`.
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
    follow: bool = True
    speed: Speed | None = None

    def __post_init__(self) -> None:
        if not len(self.rotor_hz) or min(self.rotor_hz) <= 0.0:
            raise ValueError(f'rotor_hz is {self.rotor_hz}, expected a positive speed (Hz) for each rotor')
        if self.blades < 1:
            raise ValueError(f'blades is {self.blades}, expected 1 or more')
        if not len(self.harmonics_db):
            raise ValueError('harmonics_db is empty, expected the level of the first harmonic at least')
        if self.blades * self.harmonics > _TABLE // 2:
            raise ValueError(f'harmonics is {self.harmonics}, expected at most {_TABLE // 2} over {self.blades} blades')
        low, high = self.broadband_hz
        if not 0.0 < low < high:
            raise ValueError(f'broadband_hz is {self.broadband_hz}, expected two increasing positive frequencies')

    def stream(self, sample_rate: int, key: Sequence[int], position: Position) -> Stream:
        """See SourceSignal."""
        speed = self.speed or (thrust_speed(position) if self.follow else _hover)
        turns = _Turns(self, speed, sample_rate, key)
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

    def __init__(self, signal: RotorSignal, speed: Speed, sample_rate: int, key: Sequence[int]):
        rotors = len(signal.rotor_hz)
        self._signal, self._rate, self._speed_given = signal, sample_rate, speed
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
            if forgotten % _MILESTONE:
                self._at_start.pop(forgotten, None)
        return self._at_start[index]

    def _speed(self, times: NDArray) -> NDArray:
        """Speeds (Hz, (k, rotors)) of the rotors at times (s, (k,))."""
        wander = 1.0 + self._signal.jitter * self._turbulence(times)
        return np.asarray(self._signal.rotor_hz) * wander * self._speed_given(times)
