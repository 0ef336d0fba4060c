"""The rig's ego-noise, known from a recording of the rig alone and taken off what is heard."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from av_audio.capture import open_sound

LEAST_S = 2.0  # a shorter recording knows hardly more than its own chance
# Width of the running mean over frequency: speeds of rotors, and so their lines, wander.
SMOOTH_HZ = 40.0
# So much more than the mean is subtracted, against what is chance in a window (Berouti, Schwartz, Makhoul, 1979).
OVER_SUBTRACTION = 1.5


class NoiseRecording(NamedTuple):
    """Sound (n, m) of the rig with nothing else to hear, one channel per microphone; `name` is for people."""

    samples: NDArray[np.float32]
    sample_rate: int
    name: str = 'ego-noise'

    @classmethod
    def load(cls, path: str | Path) -> NoiseRecording:
        """Read a sound file. Raises OSError that names the file."""
        with open_sound(path) as file:
            return cls(file.read(dtype='float32', always_2d=True), file.samplerate, str(path))

    def check(self, channels: int, sample_rate: int) -> None:
        """Raise ValueError where it is none of microphones (`channels`) that are heard at `sample_rate` (Hz)."""
        if self.samples.ndim != 2 or self.samples.shape[1] != channels:
            raise ValueError(f'{self.name} has samples of shape {self.samples.shape}, expected (n, {channels}): a channel '
                             'for each microphone')
        if self.sample_rate != sample_rate:
            raise ValueError(f'{self.name} was recorded at {self.sample_rate} Hz, expected {sample_rate} Hz as the sound')
        if len(self.samples) < LEAST_S * sample_rate:
            raise ValueError(f'{self.name} lasts {len(self.samples) / sample_rate:.1f} s, expected {LEAST_S:g} s or more')
        if not np.isfinite(self.samples).all():
            raise ValueError(f'{self.name} has samples that are no numbers')
        if not self.samples.any(axis=0).all():
            raise ValueError(f'{self.name} has a silent channel')


class EgoNoise:
    """Spatial covariance of the ego-noise by frequency.

    Rotors beside the microphones are as loud as any target, but always in the same places: what they make of the
    cross-spectra is known up to their level, and is subtracted before anything is weighed (Boll, 1979, does so with spectra; of
    cross-spectra even the chance in a single window averages out over frequency). The level is that of the ego-noise in
    the cross-spectra of each window by weighted least squares: what comes from elsewhere has other phases, and no share in it.
    """

    def __init__(self, windows: Iterable[NDArray], bin_hz: float) -> None:
        """`windows` are spectra (m, k) of the recording, at least one, of which one at a time is held; the scale is free."""
        self._bins = max(1, round(SMOOTH_HZ / bin_hz))
        covariance = sum(map(_covariance, windows))
        smooth = self._smooth(covariance.real) + 1j * self._smooth(covariance.imag)
        self._own = smooth.astype(np.complex64)  # (m, m, k)
        self._pairs = np.triu_indices(len(covariance), 1)

    def covariance_in(self, spectra: NDArray) -> NDArray:
        """Covariance (m, m, k) of the ego-noise in a window with spectra (m, k), 0 where these are 0."""
        covariance = _covariance(spectra)
        power = np.einsum('iik->k', covariance.real)
        used = power > 0.0
        if not used.any():
            return np.zeros_like(covariance)
        weights = used / np.maximum(self._smooth(power) / power.mean(), 1e-6) ** 2
        heard, own = covariance[self._pairs], self._own[self._pairs]
        level = float(np.sum(weights * (heard * own.conj()).real) / np.sum(weights * np.abs(own) ** 2))
        return self._own * (OVER_SUBTRACTION * max(level, 0.0) * used).astype(np.float32)

    def _smooth(self, values: NDArray) -> NDArray:
        return uniform_filter1d(values, self._bins, axis=-1, mode='nearest')


def _covariance(spectra: NDArray) -> NDArray:
    return spectra[:, None] * spectra[None].conj()
