"""The voice of a multirotor: harmonics of each rotor's blade passing, and the broadband noise of its blades."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import firwin

from av_sim_bridge.sound.delays import Position
from av_sim_bridge.sound.levels import db_to_ratio, spl_to_pascal
from av_sim_bridge.sound.stream import CHUNK, Stream, band_power, filtered, generator, white_noise

_TABLE = 8192  # points of one rotor turn
_NODES = 128  # instants a chunk at which the rotors' speeds are evaluated
_JITTER_TERMS = 24


@dataclass(frozen=True)
class RotorVoice:
    """Several rotors. Levels are those of the whole vehicle at 1 m.

    Each rotor repeats one waveform a turn: its orders are the multiples of `blades` at `harmonics_db` (beyond the list they
    fall by `rolloff_db` each) and, from imbalance, all other orders `imbalance_db` below the first harmonic.
    Turbulence makes each rotor's speed wander by `jitter` (relative, root mean square) with a Lorentz-like spectrum up to
    `jitter_hz`. `speed` gives the rotors' speeds relative to `rotor_hz` at times (k,) as (k,) or (k, rotors), for manoeuvres.
    The broadband part lies in `broadband_hz` and is modulated by the blade passing.
    """

    rotor_hz: Sequence[float] = (92.0, 94.5, 90.5, 96.0)
    blades: int = 2
    tone_db_spl: float = 72.0
    harmonics_db: Sequence[float] = (0.0, -3.0, -6.0, -7.0, -9.0, -11.0)
    rolloff_db: float = 1.5
    orders: int = 30
    imbalance_db: float = -20.0
    jitter: float = 0.004
    jitter_hz: float = 12.0
    broadband_db_spl: float = 70.0
    broadband_hz: tuple[float, float] = (400.0, 7000.0)
    modulation: float = 0.3
    speed: Callable[[NDArray], NDArray] | None = None

    def __post_init__(self) -> None:
        if not len(self.rotor_hz) or min(self.rotor_hz) <= 0.0:
            raise ValueError(f'rotor_hz is {self.rotor_hz}, expected one positive speed in turns per second for each rotor')
        if self.blades < 1:
            raise ValueError(f'blades is {self.blades}, expected 1 or more')

    def stream(self, sample_rate: int, key: Sequence[int], position: Position) -> Stream:
        return _RotorStream(self, sample_rate, key).stream


class _RotorStream:
    """State of one vehicle: the rotors' phases at the chunks' beginnings, counted from time zero both ways."""

    def __init__(self, voice: RotorVoice, sample_rate: int, key: Sequence[int]):
        self._voice, self._rate, self._key = voice, sample_rate, tuple(key)
        self._rotor_hz = np.asarray(voice.rotor_hz, float)
        random = np.random.default_rng([*self._key, 0])
        rotors = len(self._rotor_hz)
        self._start_phase = random.random(rotors)
        # Jitter as a sum of sines (Shinozuka 1972), so that it is known at every instant without a history.
        self._jitter_hz = voice.jitter_hz * random.uniform(0.02, 1.0, (_JITTER_TERMS, rotors)) ** 2
        self._jitter_angle = random.uniform(0.0, 2 * np.pi, (_JITTER_TERMS, rotors))
        self._turn_at = lru_cache(maxsize=None)(self._turn_at_chunk)
        self._waveform = self._make_waveform(random)
        half_taps = 128
        shape = firwin(2 * half_taps + 1, self._band(), pass_zero=False, fs=sample_rate)
        self._broadband = filtered(white_noise([*self._key, 1]), shape)
        self._broadband_gain = spl_to_pascal(voice.broadband_db_spl) / np.sqrt(
            np.sum(shape**2) * (1.0 + voice.modulation**2 / 2.0))
        self.stream = Stream(self._make)
