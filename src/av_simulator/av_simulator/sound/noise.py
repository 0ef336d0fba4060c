"""Noise at the microphones: wind, traffic, diffuse noise, the rig's own rotors, and self-noise of the microphones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from av_common.config_reader import bounded
from av_simulator.sound.delays import AFTER, BEFORE, interpolate
from av_simulator.sound.fields import corcos, diffuse, field_noise, horizontal
from av_simulator.sound.rotor import RotorSignal
from av_simulator.sound.stream import CHUNK, Stream, Wander, spl_to_pascal, white_noise
from av_simulator.trajectories import Static

# A-weighted spectrum of traffic in third octaves from 100 Hz (EN 1793-3), and the A-weighting of these bands (IEC 61672-1).
_TRAFFIC_DBA = (-20, -20, -18, -16, -15, -14, -13, -12, -11, -9, -8, -9, -10, -11, -13, -15, -16, -18)
_A_WEIGHT_DB = (-19.1, -16.1, -13.4, -10.9, -8.6, -6.6, -4.8, -3.2, -1.9, -0.8, 0.0, 0.6, 1.0, 1.2, 1.3, 1.2, 1.0, 0.5)
_THIRD_OCTAVES_HZ = 1000.0 * 2.0 ** (np.arange(-10, 8) / 3.0)  # 100 Hz to 5 kHz
HOVERING = Static((0.0, 0.0, 0.0))  # the rotors' speeds do not follow the motion of the rig


@dataclass(frozen=True)
class EgoRotors:
    """The rig's own rotors. The body is rigid, so that distances and delays to the microphones are constant.

    Parameters:
        signal: signal of the whole vehicle.
        rotors (m, (rotors, 3)): positions of the hubs in the body frame.
        microphones (m, (m, 3)): positions of the microphones in the body frame.
    """

    signal: RotorSignal
    rotors: Sequence[Sequence[float]] = bounded(low=-100.0, high=100.0)
    microphones: Sequence[Sequence[float]] = bounded((), low=-100.0, high=100.0)

    def __post_init__(self) -> None:
        if np.shape(self.rotors) != (len(self.signal.rotor_hz), 3):
            raise ValueError(f'ego rotors have shape {np.shape(self.rotors)}, expected ({len(self.signal.rotor_hz)}, 3), '
                             'one position for each speed in rotor_hz')

    def stream(self, sample_rate: int, microphones: int, speed_of_sound: float, key: Sequence[int]) -> Stream:
        """Pressure (Pa, (m, CHUNK)) at the microphones: each rotor with a gain of 1/r, r at least 5 cm.

        Raises ValueError for a wrong number of microphone positions.

        Parameters:
            sample_rate (Hz): sample rate.
            microphones: number of microphones.
            speed_of_sound (m/s): speed of sound.
            key: seed.
        """
        if np.shape(self.microphones) != (microphones, 3):
            raise ValueError(f'ego rotors: microphones have shape {np.shape(self.microphones)}, expected ({microphones}, 3)')
        away = np.asarray(self.rotors, float)[:, None] - np.asarray(self.microphones, float)
        distance = np.maximum(np.linalg.norm(away, axis=-1), 0.05)[..., None]  # (rotors, m, 1)
        signals = [self._signal_of(number).stream(sample_rate, [*key, number], HOVERING) for number in range(len(self.rotors))]
        delay = distance * (sample_rate / speed_of_sound)
        reach = int(delay.max()) + BEFORE + 2
        places = np.arange(CHUNK) + reach - delay
        rows = np.broadcast_to(np.arange(len(signals))[:, None, None], places.shape)

        def make(index: int) -> NDArray:
            turned = [signal.read(index * CHUNK - reach, (index + 1) * CHUNK + AFTER + 2) for signal in signals]
            return (interpolate(np.array(turned), rows, places) / distance).sum(axis=0)

        return Stream(make)

    def _signal_of(self, rotor: int) -> RotorSignal:
        """The signal of one rotor, with its share of the vehicle's power."""
        share_db = 10.0 * np.log10(len(self.rotors))
        return replace(self.signal, rotor_hz=(self.signal.rotor_hz[rotor],),
                       tone_db_spl=self.signal.tone_db_spl - share_db, broadband_db_spl=self.signal.broadband_db_spl - share_db)


@dataclass(frozen=True)
class Snr:
    """Signal-to-noise ratio of the first source and all noise at one microphone.

    Parameters:
        ratio_db (dB): ratio of the powers in the band.
        distance_m (m): distance of the source in the free field to which the ratio refers.
        band_hz (Hz): lower and upper end of the band.
    """

    ratio_db: float = bounded(low=-200.0, high=200.0)
    distance_m: float = bounded(10.0, above=0.0)
    band_hz: tuple[float, float] = bounded((200.0, 4000.0), above=0.0, high=1e6)


@dataclass(frozen=True)
class Wind:
    """Wind noise, which is turbulent pressure at the microphones. It grows with the square of the wind speed.

    Parameters:
        velocity (m/s, (x, y, z)): velocity of the wind in ENU.
        level_db_spl (dB SPL): mean level; None for 35 dB + 40 dB lg(speed), that of a microphone with a foam windscreen.
        gusts: relative RMS variation of the speed, at frequencies up to 1 Hz.
    """

    velocity: Sequence[float] = bounded((5.0, 0.0, 0.0), low=-100.0, high=100.0, longest=3)
    level_db_spl: float | None = bounded(None, low=-200.0, high=200.0)
    gusts: float = bounded(0.25, low=0.0, high=10.0)

    def __post_init__(self) -> None:
        if len(self.velocity) != 3 or not np.linalg.norm(self.velocity) > 0.0:
            raise ValueError(f'wind velocity is {list(self.velocity)}, expected a speed above 0 (omit wind for calm air)')

    def stream(self, sample_rate: int, layout: NDArray, key: Sequence[int]) -> Stream:
        """Pressure (Pa, (m, CHUNK)), with a spectrum that falls as f^(-7/3) above 0.1 Hz per m/s (inertial range).

        Parameters:
            sample_rate (Hz): sample rate.
            layout (m, (m, 3)): positions of the microphones in ENU.
            key: seed.
        """
        speed = float(np.linalg.norm(self.velocity))
        level = spl_to_pascal(35.0 + 40.0 * np.log10(speed) if self.level_db_spl is None else self.level_db_spl)
        turbulence = field_noise([*key, 0], sample_rate, layout, lambda f: (1.0 + (10.0 * f / speed) ** 2) ** (-7.0 / 6.0),
                                 corcos(self.velocity))
        gust = Wander([*key, 1], 1.0)
        level /= np.sqrt(1.0 + 6.0 * self.gusts**2 + 3.0 * self.gusts**4)  # mean fourth power of the relative speed
        return _swelling(turbulence, sample_rate, lambda t: level * np.maximum(1.0 + self.gusts * gust(t)[:, 0], 0.0) ** 2)


@dataclass(frozen=True)
class Noise:
    """All noise. Levels are those at one microphone; None disables a kind of noise.

    Parameters:
        self_noise_db_spl (dB SPL): self-noise of the microphones, white up to half the sample rate.
        wind: wind noise.
        urban_db_spl (dB SPL): traffic from all horizontal directions.
        urban_swing_db (dB): standard deviation of the traffic's level over time.
        diffuse_db_spl (dB SPL): diffuse pink noise.
        ego_rotors: the rig's own rotors.
        snr: signal-to-noise ratio to which the sum is scaled; the levels then only set the proportions.
    """

    self_noise_db_spl: float | None = bounded(30.0, low=-200.0, high=200.0)
    wind: Wind | None = None
    urban_db_spl: float | None = bounded(None, low=-200.0, high=200.0)
    urban_swing_db: float = bounded(3.0, low=0.0, high=100.0)
    diffuse_db_spl: float | None = bounded(None, low=-200.0, high=200.0)
    ego_rotors: EgoRotors | None = None
    snr: Snr | None = None

    def __post_init__(self) -> None:
        kinds = (self.self_noise_db_spl, self.wind, self.urban_db_spl, self.diffuse_db_spl, self.ego_rotors)
        if self.snr is not None and all(kind is None for kind in kinds):
            raise ValueError('snr is given without noise, expected a level of one kind of noise at least')

    def steady(self) -> Noise:
        """Noise of the same mean levels without variation over time, for measurements of the level."""
        return replace(self, urban_swing_db=0.0, wind=None if self.wind is None else replace(self.wind, gusts=0.0))

    def stream(self, sample_rate: int, layout: NDArray, speed_of_sound: float, key: Sequence[int]) -> Stream:
        """Pressure (Pa, (m, CHUNK)) before the scaling to `snr`.

        Parameters:
            sample_rate (Hz): sample rate.
            layout (m, (m, 3)): positions of the microphones in ENU.
            speed_of_sound (m/s): speed of sound.
            key: seed.
        """
        kinds = []
        if self.self_noise_db_spl is not None:
            kinds.append(_scaled(white_noise([*key, 0], len(layout)), self.self_noise_db_spl))
        if self.wind is not None:
            kinds.append(self.wind.stream(sample_rate, layout, [*key, 1]))
        if self.urban_db_spl is not None:
            traffic = field_noise([*key, 2, 0], sample_rate, layout, _traffic_density, horizontal(speed_of_sound))
            swing, spread = Wander([*key, 2, 1], 0.2), np.log(10.0) / 20.0 * self.urban_swing_db
            level = spl_to_pascal(self.urban_db_spl) * np.exp(-spread**2)  # normalises the mean power of the log-normal level
            kinds.append(_swelling(traffic, sample_rate, lambda t: level * np.exp(spread * swing(t)[:, 0])))
        if self.diffuse_db_spl is not None:
            pink = field_noise([*key, 3], sample_rate, layout, lambda f: 1.0 / np.maximum(f, 20.0), diffuse(speed_of_sound))
            kinds.append(_scaled(pink, self.diffuse_db_spl))
        if self.ego_rotors is not None:
            kinds.append(self.ego_rotors.stream(sample_rate, len(layout), speed_of_sound, [*key, 4]))
        silence = np.zeros((len(layout), CHUNK))
        return Stream(lambda index: sum((kind.read(index * CHUNK, (index + 1) * CHUNK) for kind in kinds), start=silence))


def _traffic_density(frequency_hz: NDArray) -> NDArray:
    """Power spectral density of traffic: the bands' levels divided by their widths, constant beyond the ends."""
    bands_db = np.subtract(_TRAFFIC_DBA, _A_WEIGHT_DB) - 10.0 * np.log10(_THIRD_OCTAVES_HZ)
    inside = 10.0 ** (np.interp(np.log(frequency_hz), np.log(_THIRD_OCTAVES_HZ), bands_db) / 10.0)
    return inside / (1.0 + (frequency_hz / 8000.0) ** 4)


def _scaled(noise: Stream, level_db_spl: float) -> Stream:
    level = spl_to_pascal(level_db_spl)
    return Stream(lambda index: level * noise.read(index * CHUNK, (index + 1) * CHUNK))


def _swelling(noise: Stream, sample_rate: int, level: Callable[[NDArray], NDArray]) -> Stream:
    """Noise multiplied by a slowly varying level, a function of times (s, (k,))."""
    def make(index: int) -> NDArray:
        places = index * CHUNK + np.arange(0, CHUNK + 1, CHUNK // 16)
        swell = np.interp(np.arange(index * CHUNK, (index + 1) * CHUNK), places, level(places / sample_rate))
        return swell * noise.read(index * CHUNK, (index + 1) * CHUNK)

    return Stream(make)
