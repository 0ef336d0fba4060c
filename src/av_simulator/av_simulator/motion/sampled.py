"""Motion of a rigid body between samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from av_sim_bridge.vehicle import VehicleState


@dataclass(frozen=True)
class SampledMotion:
    """Motion through samples, position as cubic polynomials, attitude on the shortest turns. It rests before and after.

    Parameters:
        times (s, (k,)): times of the samples, strictly increasing, at least two.
        positions (m, (k, 3)), velocities (m/s, (k, 3)), accelerations (m/s^2, (k, 3)): in ENU.
        rotations ((k, 3, 3)): from the body (FLU) to ENU.
    """

    times: NDArray
    positions: NDArray
    velocities: NDArray
    accelerations: NDArray
    rotations: NDArray

    def poses(self, times: ArrayLike) -> tuple[NDArray, NDArray]:
        """Positions (k, 3) in ENU and rotations (k, 3, 3) from the body to ENU at times (s, (k,))."""
        t = np.clip(np.atleast_1d(np.asarray(times, float)), self.times[0], self.times[-1])
        return self._path(t), self._attitude(t).as_matrix()

    def state(self, time: float) -> VehicleState:
        """The state at a time (s)."""
        t = float(np.clip(time, self.times[0], self.times[-1]))
        acceleration, rate = (np.array([np.interp(t, self.times, column) for column in values.T])
                              for values in (self.accelerations, self._rates))
        return VehicleState(time, self._path(t), self._path(t, 1), acceleration,
                            self._attitude(t).as_quat()[[3, 0, 1, 2]], rate)

    @cached_property
    def _path(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.times, self.positions, self.velocities)

    @cached_property
    def _attitude(self) -> Slerp:
        return Slerp(self.times, Rotation.from_matrix(self.rotations))

    @cached_property
    def _rates(self) -> NDArray:
        """Angular rates (rad/s, (k, 3)) in FLU at the samples: means of those before and after, continued at both ends."""
        attitudes = Rotation.from_matrix(self.rotations)
        between = (attitudes[:-1].inv() * attitudes[1:]).as_rotvec() / np.diff(self.times)[:, np.newaxis]
        if len(between) == 1:
            return np.repeat(between, 2, axis=0)
        ends = 1.5 * between[[0, -1]] - 0.5 * between[[1, -2]]
        return np.concatenate([ends[:1], 0.5 * (between[:-1] + between[1:]), ends[1:]])
