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

    def path(self, target: Position, now: Kinematics, dt: float, time: float) -> Kinematics:
        """Where the rig shall be.

        Parameters:
            target: trajectory of the target.
            now: where the rig should be until now.
            dt (s): time since then.
            time (s): the time.
        """
        place, ahead = target(np.array([time]))[0], velocity(target, time)[0]
        away = now.position[:2] - place[:2]
        distance = max(float(np.linalg.norm(away)), 1e-6)
        goal = np.array([*(place[:2] + self.distance / distance * away), max(place[2] + self.height, self.floor)])
        wanted = within(ahead + GAIN * (goal - now.position), self.max_speed)
        acceleration = within((wanted - now.velocity) / LAG, self.max_acceleration)
        speed = now.velocity + dt * acceleration
        return Kinematics(now.position + 0.5 * dt * (now.velocity + speed), speed, acceleration)
