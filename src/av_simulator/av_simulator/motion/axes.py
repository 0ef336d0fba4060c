"""Axes that obey commands: the yaw of the rig, and its gimbal."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from av_common.gimbal_geometry import angles_of_command, gimbal_to_body
from av_common.rig import GimbalMount

COMMAND_LIFETIME = 0.2   # s, age of the newest command from which the rig brakes
MOST_COMMANDS = 1000     # that wait for the dead time
ENCODER_SIGMA = math.radians(0.1)  # rad, standard deviation of the gimbal's reported orientation about each axis


@dataclass(frozen=True)
class YawResponse:
    """How the body answers to a yaw rate: after the dead time, with a first-order lag and a limited acceleration.

    Parameters:
        max_rate (rad/s): limit of the yaw rate.
        max_acceleration (rad/s^2): limit of the yaw acceleration.
        dead_time (s): time before anything happens.
        lag (s): time constant.
    """

    max_rate: float
    max_acceleration: float
    dead_time: float = 0.0
    lag: float = 0.0


class YawAxis:
    """Yaw of the rig. Until the first command it turns at the planned rate.

    Attributes:
        angle (rad): yaw, counter-clockwise from east.
        rate (rad/s): yaw rate.

    Parameters:
        response: of the body.
        angle (rad): initial yaw.
        planned (rad/s): rate until the first command.
    """

    def __init__(self, response: YawResponse, angle: float, planned: float) -> None:
        self._response = response
        self._planned = self._limited(planned)
        self.angle, self.rate = angle, self._planned
        self._commands: deque[tuple[float, float]] = deque(maxlen=MOST_COMMANDS)    # time and rate

    def command(self, rate: float, time: float) -> None:
        """Set the target of the rate.

        Parameters:
            rate (rad/s): counter-clockwise.
            time (s): simulated time of the command.
        """
        self._commands.append((time, self._limited(rate)))

    def step(self, dt: float, time: float) -> float:
        """The yaw (rad) at `time` (s), `dt` (s) after the step before."""
        response, before = self._response, self.rate
        change = self._aim(time - dt - response.dead_time) - before
        if response.lag > 0.0:
            change *= 1.0 - math.exp(-dt / response.lag)
        most = response.max_acceleration * dt
        self.rate += min(max(change, -most), most)
        self.angle += 0.5 * (before + self.rate) * dt
        return self.angle

    def _aim(self, time: float) -> float:
        """The rate (rad/s) that was wanted at a time (s)."""
        while len(self._commands) > 1 and self._commands[1][0] <= time + 1e-9:
            self._commands.popleft()
        if not self._commands or self._commands[0][0] > time + 1e-9:
            return self._planned
        begin, rate = self._commands[0]
        self._planned = 0.0    # a command has taken over
        return rate if time - begin <= COMMAND_LIFETIME else 0.0

    def _limited(self, rate: float) -> float:
        return min(max(rate, -self._response.max_rate), self._response.max_rate)


class SimulatedGimbal:
    """A gimbal: two axes with limits, a highest rate and a lag, on a body that tilts. It holds where it is once commands cease.

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
