"""The rig's yaw: commanded rates, and the body's answer to them."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

COMMAND_LIFETIME = 0.2   # s, age of the newest command from which the rig brakes
MOST_COMMANDS = 1000     # that wait for the dead time


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
        self._response, self._planned = response, self._limited(response, planned)
        self.angle, self.rate = angle, self._planned
        self._commands: deque[tuple[float, float]] = deque(maxlen=MOST_COMMANDS)    # time and rate

    def command(self, rate: float, time: float) -> None:
        """Set the target of the rate.

        Parameters:
            rate (rad/s): counter-clockwise.
            time (s): simulated time of the command.
        """
        self._commands.append((time, self._limited(self._response, rate)))

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

    @staticmethod
    def _limited(response: YawResponse, rate: float) -> float:
        return min(max(rate, -response.max_rate), response.max_rate)
