"""How much of its signal a source sends which way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Unit vectors (n, 3) from the source in world ENU, frequencies (F,), time of emission in s -> amplitude factors (n, F).
Directivity = Callable[[NDArray, NDArray, float], NDArray]


@dataclass(frozen=True)
class RotorDirectivity:
    """Rotors seen from the side and from below.

    Blade tones go to the sides, in the rotors' plane, and fade by `tone_axis_db` towards the axis; broadband noise is a
    dipole along the axis that fades by `noise_side_db` in the plane. In between, levels follow the square of the
    angle's cosine. The two parts meet at `meet_hz`. The rotors' axis is vertical.
    """

    tone_axis_db: float = -6.0
    noise_side_db: float = -6.0
    meet_hz: float = 800.0

    def __call__(self, directions: NDArray, frequency_hz: NDArray, time_s: float) -> NDArray:
        """See Directivity."""
        along_axis = directions[:, 2:] ** 2
        tones = 1.0 - along_axis * (1.0 - 10.0 ** (self.tone_axis_db / 10.0))
        noise = 1.0 - (1.0 - along_axis) * (1.0 - 10.0 ** (self.noise_side_db / 10.0))
        share = 1.0 / (1.0 + (frequency_hz / self.meet_hz) ** 4)
        return np.sqrt(share * tones + (1.0 - share) * noise)


@dataclass(frozen=True)
class CardioidDirectivity:
    """A horn: 1 ahead, `1 - 2 * share` behind, towards `axis` (3,) in world ENU at every frequency."""

    axis: tuple[float, float, float]
    share: float = 0.5

    def __call__(self, directions: NDArray, frequency_hz: NDArray, time_s: float) -> NDArray:
        """See Directivity."""
        ahead = directions @ (np.asarray(self.axis) / np.linalg.norm(self.axis))
        factor = np.abs(1.0 - self.share + self.share * ahead)
        return np.repeat(factor[:, None], len(frequency_hz), axis=1)
