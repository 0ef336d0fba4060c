"""Motion of one axis within its limits of angle, rate and acceleration."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class AxisLimits:
    """Limits of an axis, for example of a gimbal's pan.

    Parameters:
        rate (rad/s), acceleration (rad/s^2): largest magnitudes, positive.
        lower, upper (rad): smallest and largest angle, around the neutral angle 0; infinite for continuous rotation.

    Raises ValueError for limits that contradict each other.
    """

    rate: float
    acceleration: float
    lower: float = -math.inf
    upper: float = math.inf

    def __post_init__(self) -> None:
        if not (self.rate > 0.0 and self.acceleration > 0.0 and self.lower <= 0.0 <= self.upper):
            raise ValueError(f'axis limits {self} must have positive rate and acceleration, and hold the neutral angle 0')


class LimitedAxis:
    """Follows a target angle; `position` (rad) and `velocity` (rad/s) are the commanded ones."""

    def __init__(self, limits: AxisLimits) -> None:
        self.limits = limits
        self.position = 0.0
        self.velocity = 0.0

    def follow(self, error: float, target_rate: float, dt: float, rate: float = math.inf,
               gain: float = math.inf) -> None:
        """Move towards a moving target at the rate from which the axis can still brake, sqrt(2 a e): no overshoot.

        Parameters:
            error (rad): angle to the target.
            target_rate (rad/s): rate of the target itself.
            dt (s): duration of the step.
            rate (rad/s): limit of the rate for this step, in addition to the limit of the axis.
            gain (1/s): largest rate relative to the error, for an axis that is late.
        """
        acceleration = 0.5 * self.limits.acceleration  # the other half is reserved for manoeuvres of the target
        approach = math.copysign(min(_brakeable(abs(error), acceleration, dt), gain * abs(error)) if error else 0.0, error)
        self._drive(approach + target_rate, dt, rate)

    def stop(self, dt: float) -> None:
        """Brake for `dt` s as hard as the limits allow."""
        self._drive(0.0, dt, math.inf)

    def limit(self, rate: float) -> None:
        """Limit the velocity at once. A limit that falls no faster than the axis can brake needs no larger acceleration.

        Parameters:
            rate (rad/s): largest magnitude.
        """
        self.velocity = min(max(self.velocity, -rate), rate)

    def _drive(self, wanted: float, dt: float, rate: float) -> None:
        limits = self.limits
        change = limits.acceleration * dt
        ceiling = min(limits.rate, rate)
        wanted = min(max(wanted, -ceiling), ceiling)
        wanted = min(max(wanted, self.velocity - change), self.velocity + change)
        # Never faster than the axis can brake before the end stop, for any later command.
        wanted = min(wanted, _brakeable(limits.upper - self.position, limits.acceleration, dt))
        wanted = max(wanted, -_brakeable(self.position - limits.lower, limits.acceleration, dt))
        self.velocity = wanted
        self.position = min(max(self.position + wanted * dt, limits.lower), limits.upper)


def _brakeable(distance: float, acceleration: float, dt: float) -> float:
    """The largest v for which a step v*dt and the braking distance v^2/(2a) fit into `distance`."""
    if math.isinf(distance):
        return math.inf
    return acceleration * (math.sqrt(dt * dt + 2.0 * max(distance, 0.0) / acceleration) - dt)
