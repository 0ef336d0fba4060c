"""A path that follows a target at a distance, as a pilot who sees the target flies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from av_common.config_reader import bounded
from av_simulator.motion.bodies import Kinematics, within
from av_simulator.trajectories import Position, velocity

GAIN = 0.5      # 1/s, velocity towards the place that is aimed for, over the distance to it
LAG = 0.5       # s, in which the velocity reaches what is wanted


@dataclass(frozen=True)
class Pursuit:
    """The rig flies after a target, by the target's true position: sensors and estimates of the rig do not fly it.

    Parameters:
        target: index of the target.
        distance (m): horizontal distance that is kept.
        height (m): height above the target that is kept.
        floor (m): least height above ground.
        max_speed (m/s), max_acceleration (m/s^2): limits.
        begin (s): time of the start; before, the rig follows its trajectory.
    """

    target: int = bounded(0, low=0, high=99)
    distance: float = bounded(10.0, low=1.0, high=1000.0)
    height: float = bounded(-1.0, low=-100.0, high=100.0)
    floor: float = bounded(1.5, low=0.0, high=1000.0)
    max_speed: float = bounded(12.0, above=0.0, high=60.0)
    max_acceleration: float = bounded(4.0, above=0.0, high=50.0)
    begin: float = bounded(0.0, low=0.0)


class PursuitPath:
    """The path of a pursuit, step by step.

    Parameters:
        pursuit: its settings.
        target: trajectory of the target.
        start: where the path begins.
    """

    def __init__(self, pursuit: Pursuit, target: Position, start: Kinematics) -> None:
        self._settings, self._target, self._now = pursuit, target, start

    def step(self, dt: float, time: float) -> Kinematics:
        """Where the rig shall be at `time` (s), `dt` (s) after the step before."""
        settings, now = self._settings, self._now
        target, ahead = self._target(np.array([time]))[0], velocity(self._target, time)[0]
        away = now.position[:2] - target[:2]
        distance = max(float(np.linalg.norm(away)), 1e-6)
        goal = np.array([*(target[:2] + settings.distance / distance * away), max(target[2] + settings.height, settings.floor)])
        wanted = within(ahead + GAIN * (goal - now.position), settings.max_speed)
        acceleration = within((wanted - now.velocity) / LAG, settings.max_acceleration)
        speed = now.velocity + dt * acceleration
        self._now = Kinematics(now.position + 0.5 * dt * (now.velocity + speed), speed, acceleration)
        return self._now
