"""How the simulated rig turns: its yaw rate follows the commanded one with limited acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_sim_bridge.scenario import RigMotion

COMMAND_LIFETIME = 0.5   # s; a rig whose commands cease stops


@dataclass(frozen=True)
class Turn:
    """Yaw from `start` s on, while one rate is aimed at: angles in rad, rates in rad/s, counter-clockwise."""

    start: float
    yaw0: float
    rate0: float
    aim: float
    acceleration: float

    def rate(self, times: ArrayLike) -> NDArray:
        """Yaw rates at times from `start` on."""
        reach = self.acceleration * (np.asarray(times, float) - self.start)
        return self.rate0 + np.clip(self.aim - self.rate0, -reach, reach)

    def yaw(self, times: ArrayLike) -> NDArray:
        """Yaw at times from `start` on: a ramp of the rate, then a constant rate."""
        elapsed = np.asarray(times, float) - self.start
        change = self.aim - self.rate0
        ramp = np.minimum(elapsed, abs(change) / self.acceleration)
        ramped = self.rate0 * ramp + np.sign(change) * self.acceleration * ramp**2 / 2
        return self.yaw0 + ramped + self.aim * (elapsed - ramp)


class RigDynamics:
    """The rig's yaw from one step to the next. Commands are obeyed from the next step on."""

    def __init__(self, motion: RigMotion):
        self._limit = np.deg2rad(motion.max_yaw_rate_deg)
        self._acceleration = np.deg2rad(motion.max_yaw_acceleration_deg)
        self._programme: float | None = np.deg2rad(motion.yaw_rate_deg)   # until the first command
        self._command, self._commanded = 0.0, -np.inf
        rate = 0.0 if self._programme is None else float(np.clip(self._programme, -self._limit, self._limit))
        self.turn = Turn(0.0, float(np.deg2rad(motion.yaw_deg)), rate, rate, self._acceleration)

    def command(self, yaw_rate: float, time: float) -> None:
        """Aim at a yaw rate in rad/s, counter-clockwise, given at `time` s."""
        self._programme = None
        self._command, self._commanded = yaw_rate, time

    def step(self, start: float) -> Turn:
        """The turn from `start` s on, until the next step."""
        if self._programme is not None:
            aim = self._programme
        else:
            aim = self._command if start - self._commanded <= COMMAND_LIFETIME else 0.0
        aim = float(np.clip(aim, -self._limit, self._limit))
        self.turn = Turn(start, float(self.turn.yaw(start)), float(self.turn.rate(start)), aim, self._acceleration)
        return self.turn
