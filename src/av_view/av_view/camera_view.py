"""Where directions of the rig's body are in the camera's picture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.angles import wrap
from av_common.camera import PinholeCamera
from av_fusion.measurement.vectors import angles

# Points of a meridian: enough for a smooth line through a distorted picture.
STEPS = 13
MARGIN = 1.15  # of the half field of view, to which a band is clipped


@dataclass(frozen=True)
class CameraView:
    """A camera as it is turned on the body. Points are shares of the picture's sides, (0, 0) its top-left corner.

    Parameters:
        model: intrinsics.
        rotation (3, 3): from the camera's optical frame to the body's.
    """

    model: PinholeCamera
    rotation: NDArray[np.float64]

    @cached_property
    def axis(self) -> tuple[float, float]:
        """Azimuth and elevation (rad) of the middle of the field of view in the body frame."""
        return angles(tuple((self.rotation @ self.model.view)[:, 2].tolist()))

    def azimuth_of(self, x: float, y: float) -> float:
        """Azimuth (rad) in the body frame of the pixel (x, y); nan for no pixel."""
        if not (math.isfinite(x) and math.isfinite(y)):
            return math.nan
        return angles(tuple((self.rotation @ self.model.rays([[x, y]])[0]).tolist()))[0]

    def point(self, azimuth: float, elevation: float) -> list[float] | None:
        """Where a direction is in the picture; None outside of it.

        Parameters:
            azimuth, elevation (rad): in the body frame.
        """
        found = self._project([azimuth], [elevation])
        return found[0] if found and 0.0 <= found[0][0] <= 1.0 and 0.0 <= found[0][1] <= 1.0 else None

    def meridian(self, azimuth: float) -> list[list[float]]:
        """The line of all directions of one azimuth (rad), from below to above; empty behind the camera."""
        return self._project(np.full(STEPS, azimuth), self._elevations)

    def band(self, azimuth: float, sigma: float) -> list[list[float]]:
        """The outline of all directions within `sigma` (rad) of `azimuth` (rad), clipped to the field of view."""
        half = 0.5 * MARGIN * max(self.model.horizontal_fov_rad, self.model.vertical_fov_rad)
        offset = wrap(azimuth - self.axis[0])
        if not (math.isfinite(offset) and math.isfinite(sigma)):
            return []
        left, right = (float(np.clip(offset + side * sigma, -half, half)) for side in (1.0, -1.0))
        if left == right:
            return []
        azimuths = np.repeat([self.axis[0] + left, self.axis[0] + right], STEPS)
        return self._project(azimuths, np.concatenate([self._elevations, self._elevations[::-1]]))

    @cached_property
    def _elevations(self) -> NDArray[np.float64]:
        half = 0.5 * max(self.model.horizontal_fov_rad, self.model.vertical_fov_rad)  # the longer side may be upright
        return np.linspace(max(self.axis[1] - half, -1.5), min(self.axis[1] + half, 1.5), STEPS)

    def _project(self, azimuths: ArrayLike, elevations: ArrayLike) -> list[list[float]]:
        azimuth, elevation = np.asarray(azimuths, float), np.asarray(elevations, float)
        if not (np.isfinite(azimuth).all() and np.isfinite(elevation).all()):
            return []
        level = np.cos(elevation)
        directions = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
        optical = directions @ self.rotation
        pixels = self.model.project(optical[optical[:, 2] > 0.1])
        shares = np.round((pixels + 0.5) / (self.model.width, self.model.height), 4)
        points: list[list[float]] = shares[np.isfinite(shares).all(1)].tolist()
        return points
