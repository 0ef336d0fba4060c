"""Where a gimbal can turn the camera, and how long that takes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from av_common.angles import angles_to_direction, direction_to_angles
from av_common.rig import GimbalMount

BESIDE = math.radians(75.0)  # from a stop of the gimbal, up to which a wide view from there may show something

Matrix = NDArray[np.float64]


class GimbalReach:
    """Pans and tilts within the limits of a gimbal.

    Parameters:
        gimbal: its limits and rate.
    """

    def __init__(self, gimbal: GimbalMount) -> None:
        self._limits = np.radians([gimbal.pan_limits_deg, gimbal.tilt_limits_deg])
        self._rate = math.radians(gimbal.max_rate_deg)

    def reachable(self, directions: Matrix) -> Matrix:
        """Pans and tilts (m, 2) that are closest to directions (n, 3) in the mount's frame, from either stop."""
        pan, tilt = direction_to_angles(directions)
        (left, right), (low, high) = self._limits
        turned = np.concatenate([pan, pan + math.tau, pan - math.tau])
        reached = np.stack([np.clip(turned, left, right), np.tile(np.clip(tilt, low, high), 3)], axis=1)
        return np.unique(reached[np.abs(reached[:, 0] - turned) < BESIDE], axis=0)

    def nearest(self, direction: Matrix) -> Matrix:
        """Pan and tilt (2,) that are closest to a direction (3,) in the mount's frame."""
        reached = self.reachable(direction[None])
        off = [angles_to_direction(*angles) @ direction for angles in reached]
        return reached[int(np.argmax(off))] if len(reached) else np.zeros(2)

    def times(self, looks: Matrix, now: Matrix) -> Matrix:
        """Time (s, (m,)) of the way from a pan and tilt (2,) to each of others (m, 2), both axes turning at once."""
        return np.asarray(np.abs(looks - now).max(axis=1) / self._rate)
