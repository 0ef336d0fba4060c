"""Signals that sources emit: recordings, tones and formulas; rotors are in rotor.py.

A source signal is a description; its method `stream` makes the samples, the sound pressure (Pa) at 1 m as a function of the
time of emission. Sample 0 is at time 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.signal import resample_poly

from av_audio.file_source import open_sound, read_sound
from av_common.config_reader import bounded
from av_simulator.sound.stream import CHUNK, SIGNAL_CHUNKS, Stream, spl_to_pascal
from av_simulator.trajectories import Position

_FADE_S = 0.05  # s, from the end of a recording to its beginning


class SourceSignal(Protocol):
    """Description of the signal that a source emits."""

    def stream(self, sample_rate: int, key: Sequence[int], position: Position) -> Stream:
        """Samples of the sound pressure (Pa) at 1 m.

        Parameters:
            sample_rate (Hz): sample rate.
            key: seed of random numbers.
            position: trajectory of the source, for signals that depend on its motion.
        """


@dataclass(frozen=True)
class FormulaSignal:
    """A signal given by a function `pressure` from times (s, (k,)) to pressures at 1 m (Pa, (k,))."""

    pressure: Callable[[NDArray], NDArray]

    def stream(self, sample_rate: int, key: Sequence[int], position: Position) -> Stream:
        """See SourceSignal."""
        return Stream(lambda index: self.pressure(np.arange(index * CHUNK, (index + 1) * CHUNK) / sample_rate), SIGNAL_CHUNKS)


@dataclass(frozen=True)
class ToneSignal:
    """A sine of one frequency.

    Parameters:
        frequency_hz (Hz): frequency.
        level_db_spl (dB SPL): level at 1 m.
    """

    frequency_hz: float = bounded(1000.0, above=0.0, high=1e5)
    level_db_spl: float = bounded(74.0, low=-100.0, high=200.0)

    def stream(self, sample_rate: int, key: Sequence[int], position: Position) -> Stream:
        """See SourceSignal."""
        amplitude = np.sqrt(2.0) * spl_to_pascal(self.level_db_spl)
        return FormulaSignal(lambda t: amplitude * np.sin(2 * np.pi * self.frequency_hz * t)).stream(sample_rate, key, position)


@dataclass(frozen=True)
class RecordedSignal:
    """The mean of a sound file's channels, of any rate, repeated with cross-fades. Raises FileNotFoundError or ValueError.

    Parameters:
        file: path of the file, of libsndfile's formats.
        level_db_spl (dB SPL): mean level of the whole file at 1 m.
    """

    file: str | Path
    level_db_spl: float = bounded(74.0, low=-100.0, high=200.0)

    def __post_init__(self) -> None:
        open_sound(self.file).close()

    def stream(self, sample_rate: int, key: Sequence[int], position: Position) -> Stream:
        """See SourceSignal."""
        samples = _join_ends(self._load(sample_rate), int(_FADE_S * sample_rate))
        return Stream(lambda index: samples[np.arange(index * CHUNK, (index + 1) * CHUNK) % len(samples)], SIGNAL_CHUNKS)

    def _load(self, sample_rate: int) -> NDArray:
        recorded, rate = read_sound(self.file)
        ratio = Fraction(sample_rate / rate).limit_denominator(1000)
        samples = resample_poly(recorded.mean(axis=1), ratio.numerator, ratio.denominator)
        rms = np.sqrt(np.mean(samples**2))
        if not 0.0 < rms < np.inf:
            raise ValueError(f'recording: {str(self.file)!r} is silent, or has samples that are not finite')
        return samples * spl_to_pascal(self.level_db_spl) / rms


def _join_ends(samples: NDArray, fade: int) -> NDArray:
    """The recording shortened by `fade` samples, with an equal-power cross-fade from its end to its beginning."""
    fade = min(fade, len(samples) // 2)
    if fade == 0:
        return samples
    angle = (np.arange(fade) + 0.5) / fade * np.pi / 2
    joined = samples[:-fade].copy()
    joined[:fade] = np.sin(angle) * samples[:fade] + np.cos(angle) * samples[-fade:]
    return joined
