"""Directivity of sources."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from av_common.config_reader import bounded

# Unit vectors (n, 3) from the source in ENU, frequencies (Hz, (F,)), time of emission (s) -> amplitude factors (n, F).
Directivity = Callable[[NDArray, NDArray, float], NDArray]


@dataclass(frozen=True)
class RotorDirectivity:
    """Directivity of rotors with a vertical axis.

    Blade tones are radiated mainly in the rotors' plane, broadband noise mainly along the axis. Between plane and axis the
    energy follows the squared cosine of the angle. The part for tones applies below `meet_hz`, the one for noise above.

    Parameters:
        tone_axis_db (dB): level of the tones along the axis, relative to the plane.
        noise_side_db (dB): level of the noise in the plane, relative to the axis.
        meet_hz (Hz): frequency of the transition.
    """

    tone_axis_db: float = bounded(-6.0, low=-200.0, high=200.0)
    noise_side_db: float = bounded(-6.0, low=-200.0, high=200.0)
    meet_hz: float = bounded(800.0, above=0.0)

    def __call__(self, directions: NDArray, frequency_hz: NDArray, time_s: float) -> NDArray:
        """See Directivity."""
        along_axis = directions[:, 2:] ** 2
        tones = 1.0 - along_axis * (1.0 - 10.0 ** (self.tone_axis_db / 10.0))
        noise = 1.0 - (1.0 - along_axis) * (1.0 - 10.0 ** (self.noise_side_db / 10.0))
        share = 1.0 / (1.0 + (frequency_hz / self.meet_hz) ** 4)
        return np.sqrt(share * tones + (1.0 - share) * noise)


@dataclass(frozen=True)
class CardioidDirectivity:
    """Cardioid directivity of a horn at every frequency: 1 ahead and |1 - 2 * share| behind.

    Parameters:
        axis ((3,)): direction of the main lobe in ENU, of any length.
        share (0 to 1): weight of the cosine.
    """

    axis: tuple[float, float, float]
    share: float = 0.5

    def __call__(self, directions: NDArray, frequency_hz: NDArray, time_s: float) -> NDArray:
        """See Directivity."""
        ahead = directions @ (np.asarray(self.axis) / np.linalg.norm(self.axis))
        factor = np.abs(1.0 - self.share + self.share * ahead)
        return np.repeat(factor[:, None], len(frequency_hz), axis=1)
