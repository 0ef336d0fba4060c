"""The rig's own noise, known from a recording of the rig alone and taken off what is heard."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from av_audio.capture import open_sound

LEAST_S = 2.0  # a shorter recording knows hardly more than its own chance
# Width of the running mean over frequency: speeds of rotors, and so their lines, wander.
SMOOTH_HZ = 40.0


class NoiseRecording(NamedTuple):
    """Sound (n, m) of the rig with nothing else to hear, one channel per microphone; `name` is for people."""

    samples: NDArray[np.float32]
    sample_rate: int
    name: str = 'own noise'

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


class OwnNoise:
    """Spatial covariance of the own noise by frequency.

    Rotors beside the microphones are as loud as any target, but always in the same places: what they make of the
    cross-spectra is known up to their level, which is taken from each window. It is subtracted before anything is weighed
    (Boll, 1979, does so with spectra; of cross-spectra even the chance in a single window averages out over frequency).
    """

    def __init__(self, windows: Sequence[NDArray], bin_hz: float) -> None:
        """`windows` are spectra (m, k) of the recording."""
        self._bins = max(1, round(SMOOTH_HZ / bin_hz))
        covariance = np.mean([spectra[:, None] * spectra[None].conj() for spectra in windows], axis=0)
        smooth = self._smooth(covariance.real) + 1j * self._smooth(covariance.imag)
        self._covariance = smooth.astype(np.complex64)  # (m, m, k)
        self._power = np.einsum('iik->k', smooth.real)
        self._known = self._power > 1e-6 * self._power.max()

    def covariance_in(self, spectra: NDArray) -> NDArray:
        """Covariance (m, m, k) of the own noise in a window with spectra (m, k), 0 where these are 0."""
        power = np.sum(np.abs(spectra) ** 2, axis=0)
        used = self._known & (power > 0.0)
        level = float(np.median(self._smooth(power)[used] / self._power[used])) if used.any() else 0.0
        return self._covariance * (level * used).astype(np.float32)

    def _smooth(self, values: NDArray) -> NDArray:
        return uniform_filter1d(values, self._bins, axis=-1, mode='nearest')
