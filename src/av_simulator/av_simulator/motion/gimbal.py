"""A gimbal: two axes with limits, a highest rate and a lag, on a body that tilts."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from av_common.gimbal_geometry import angles_of_command, gimbal_to_body
from av_common.rig import GimbalMount
from av_simulator.motion.yaw_axis import COMMAND_LIFETIME

ENCODER_SIGMA = math.radians(0.1)    # rad, standard deviation of the reported orientation about each axis


class SimulatedGimbal:
    """Follows commands, and holds where it is once they cease.

    Parameters:
        mount: limits, rate, lag, and whether the gimbal stays level as the body tilts.
    """

    def __init__(self, mount: GimbalMount) -> None:
        self.mount = mount
        self._limits = np.radians([mount.pan_limits_deg, mount.tilt_limits_deg]).T
        self._rate = math.radians(mount.max_rate_deg)
        self._target = np.clip(np.zeros(2), *self._limits)
        self._commanded = -math.inf
        self._times, self._angles = np.zeros(1), self._target[np.newaxis]

    def command(self, pan: float, tilt: float, time: float, attitude_wxyz: NDArray) -> None:
        """Set the direction to look to, in `base_stabilized` for a stabilized gimbal, else in the body's frame.

        Parameters:
            pan, tilt (rad): counter-clockwise, and up.
            time (s): simulated time of the command.
            attitude_wxyz ((4,)): the body's attitude.
        """
        angles = angles_of_command(self.mount, pan, tilt, self.mount.stabilized, attitude_wxyz.tolist())
        self._target, self._commanded = np.clip(angles, *self._limits), time

    def step(self, times: NDArray) -> None:
        """Move through times (s, (k,)), of which the first is the last of the step before."""
        angles = np.empty((len(times), 2))
        angles[0] = self._angles[-1]
        for index, dt in enumerate(np.diff(times)):
            if times[index] - self._commanded > COMMAND_LIFETIME:
                self._target = angles[index]
            move = self._target - angles[index]
            if self.mount.lag > 0.0:
                move = (1.0 - math.exp(-dt / self.mount.lag)) * move
            angles[index + 1] = angles[index] + np.clip(move, -self._rate * dt, self._rate * dt)
        self._times, self._angles = times, angles

    def angles(self, time: float) -> tuple[float, float]:
        """Pan and tilt (rad) about the mount's axes at a time (s) within the newest step."""
        pan, tilt = (float(np.interp(time, self._times, column)) for column in self._angles.T)
        return pan, tilt

    def rotation(self, time: float, attitude_wxyz: NDArray) -> NDArray:
        """Rotation matrix (3, 3) from the gimbal's frame to the body's at a time (s) within the newest step.

        Parameters:
            time (s): the time.
            attitude_wxyz ((4,)): the body's attitude at that time.
        """
        return gimbal_to_body(self.mount, *self.angles(time), attitude_wxyz.tolist())
