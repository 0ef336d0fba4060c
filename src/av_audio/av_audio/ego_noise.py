"""Subtraction of the rig's ego-noise, which is known from a recording of the rig alone."""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from av_audio.file_source import read_sound

MIN_DURATION_S = 2.0  # the covariance of a shorter recording has too large an error
# Width of the running mean over frequency: the speeds of rotors vary, and their spectral lines with them.
SMOOTH_HZ = 40.0
# Factor of over-subtraction, against random deviations in a single window (Berouti, Schwartz, Makhoul, 1979).
OVER_SUBTRACTION = 1.5


class NoiseRecording(NamedTuple):
    """Recording of the rig without any other source.

    Parameters:
        samples (n, m): one channel per microphone.
        sample_rate (Hz): sample rate.
        name: name of the recording in messages.
    """

    samples: NDArray[np.float32]
    sample_rate: int
    name: str = 'ego-noise'

    @classmethod
    def load(cls, path: str | Path) -> NoiseRecording:
        """Load a sound file. Raises OSError or ValueError that names the file."""
        return cls(*read_sound(path), str(path))

    def check(self, channels: int, sample_rate: int) -> None:
        """Raise ValueError when it does not fit an array of `channels` microphones sampled at `sample_rate` in Hz.

        Parameters:
            channels: number of microphones.
            sample_rate (Hz): sample rate of the array.
        """
        if self.samples.ndim != 2 or self.samples.shape[1] != channels:
            raise ValueError(f'{self.name} has samples of shape {self.samples.shape}, expected (n, {channels}): a channel '
                             'for each microphone')
        if self.sample_rate != sample_rate:
            raise ValueError(f'{self.name} was recorded at {self.sample_rate} Hz, expected {sample_rate} Hz as the stream')
        if len(self.samples) < MIN_DURATION_S * sample_rate:
            raise ValueError(f'{self.name} lasts {len(self.samples) / sample_rate:.1f} s, '
                             f'expected {MIN_DURATION_S:g} s or more')
        if not np.isfinite(self.samples).all():
            raise ValueError(f'{self.name} has samples that are not finite')
        if not self.samples.any(axis=0).all():
            raise ValueError(f'{self.name} has a silent channel')


class EgoNoise:
    """Spatial covariance of the ego-noise by frequency.

    Rotors beside the microphones are as loud as a target, but their positions are fixed: their contribution to the
    cross-spectra is known up to its level and is subtracted before weighting. Boll (1979) subtracts spectra; in
    cross-spectra the random error of a single window averages out over frequency. The level in each window follows from a
    weighted least-squares fit to its cross-spectra: sources in other directions have other phases and do not bias it.

    Parameters:
        windows: spectra (m, k) of windows of the recording, at least one; consumed one at a time.
        bin_hz (Hz): distance of the bins.
    """

    def __init__(self, windows: Iterable[NDArray], bin_hz: float) -> None:
        self._bins = max(1, round(SMOOTH_HZ / bin_hz))
        covariance: NDArray = reduce(np.add, map(_covariance, windows))
        smooth = self._smooth(covariance.real) + 1j * self._smooth(covariance.imag)
        self._covariance = smooth.astype(np.complex64)  # (m, m, k)
        self._pairs = np.triu_indices(len(covariance), 1)

    def covariance_in(self, spectra: NDArray) -> NDArray:
        """Covariance (m, m, k) of the ego-noise in a window with spectra (m, k), 0 where these are 0."""
        covariance = _covariance(spectra)
        power = np.einsum('iik->k', covariance.real)
        used = power > 0.0
        if not used.any():
            return np.zeros_like(covariance)
        weights = used / np.maximum(self._smooth(power) / power.mean(), 1e-6) ** 2
        measured, noise = covariance[self._pairs], self._covariance[self._pairs]
        level = float(np.sum(weights * (measured * noise.conj()).real) / np.sum(weights * np.abs(noise) ** 2))
        return self._covariance * (OVER_SUBTRACTION * max(level, 0.0) * used).astype(np.float32)

    def _smooth(self, values: NDArray) -> NDArray:
        return uniform_filter1d(values, self._bins, axis=-1, mode='nearest')


def _covariance(spectra: NDArray) -> NDArray:
    return spectra[:, None] * spectra[None].conj()
