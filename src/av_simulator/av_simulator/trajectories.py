"""Trajectories: functions from times (s, (k,)), which may be negative, to positions (m, (k, 3)) in ENU."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from av_common.config_reader import bounded

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Static:
    """A constant position."""

    position: Vector

    def __call__(self, times: ArrayLike) -> NDArray:
        """Positions (k, 3) at times (k,)."""
        return np.tile(np.array(self.position), (len(np.atleast_1d(times)), 1))


@dataclass(frozen=True)
class Line:
    """A straight line at constant velocity.

    Parameters:
        position (m, ENU): position at `time`.
        velocity (m/s, ENU): velocity.
        time (s): time of `position`.
    """

    position: Vector
    velocity: Vector
    time: float = 0.0

    def __call__(self, times: ArrayLike) -> NDArray:
        """Positions (k, 3) at times (k,)."""
        elapsed = np.atleast_1d(np.asarray(times, float)) - self.time
        return np.array(self.position) + elapsed[:, np.newaxis] * np.array(self.velocity)


@dataclass(frozen=True)
class Circle:
    """A circle with optional oscillations of radius and height.

    Parameters:
        center (m, ENU): centre.
        radius (m): mean radius.
        period (s): time for one turn, counter-clockwise; negative for clockwise.
        start_deg (deg): angle at time 0, counter-clockwise from east.
        radius_swing (m), radius_period (s): amplitude and period of the radius' oscillation.
        height_swing (m), height_period (s): amplitude and period of the height's oscillation.
    """

    center: Vector
    radius: float = bounded(10.0, above=0.0)
    period: float = bounded(60.0, low=-1e5, high=1e5)
    start_deg: float = 0.0
    radius_swing: float = bounded(0.0, low=0.0)
    radius_period: float = bounded(20.0, above=0.0)
    height_swing: float = bounded(0.0, low=0.0)
    height_period: float = bounded(15.0, above=0.0)

    def __post_init__(self) -> None:
        if self.period == 0.0:
            raise ValueError('period: 0 s, expected a time other than 0')
        if self.radius_swing >= self.radius:
            raise ValueError(f'radius_swing: {self.radius_swing} m, expected less than the radius {self.radius} m')

    def __call__(self, times: ArrayLike) -> NDArray:
        """Positions (k, 3) at times (k,)."""
        t = np.atleast_1d(np.asarray(times, float))
        angle = np.deg2rad(self.start_deg) + 2 * np.pi * t / self.period
        radius = self.radius + self.radius_swing * np.sin(2 * np.pi * t / self.radius_period)
        height = self.height_swing * np.sin(2 * np.pi * t / self.height_period)
        return np.array(self.center) + np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)


@dataclass(frozen=True)
class FigureEight:
    """A lemniscate of Gerono.

    Parameters:
        center (m, ENU): centre.
        length (m): extent along `heading_deg`.
        width (m): extent perpendicular to it.
        period (s): time for one round.
        heading_deg (deg): direction of the long axis, counter-clockwise from east.
    """

    center: Vector
    length: float = bounded(20.0, above=0.0)
    width: float = bounded(10.0, above=0.0)
    period: float = bounded(40.0, above=0.0)
    heading_deg: float = 0.0

    def __call__(self, times: ArrayLike) -> NDArray:
        """Positions (k, 3) at times (k,)."""
        phase = 2 * np.pi * np.atleast_1d(np.asarray(times, float)) / self.period
        along, across = self.length / 2 * np.sin(phase), self.width / 2 * np.sin(2 * phase)
        c, s = np.cos(np.deg2rad(self.heading_deg)), np.sin(np.deg2rad(self.heading_deg))
        offset = np.stack([c * along - s * across, s * along + c * across, np.zeros_like(along)], axis=1)
        return np.array(self.center) + offset


@dataclass(frozen=True)
class Waypoints:
    """A cubic spline through points [time (s), x, y, z (m)], at rest before the first and after the last point."""

    points: tuple[tuple[float, float, float, float], ...] = bounded(longest=10_000)

    def __post_init__(self) -> None:
        if len(self.points) < 2:
            raise ValueError(f'points: {len(self.points)} points, expected at least 2')
        table = np.array(self.points)
        if not (np.diff(table[:, 0]) > 0).all():
            raise ValueError(f'points: times are {table[:, 0].tolist()}, expected increasing times')

    def __call__(self, times: ArrayLike) -> NDArray:
        """Positions (k, 3) at times (k,)."""
        t = np.atleast_1d(np.asarray(times, float))
        return self._spline(np.clip(t, self.points[0][0], self.points[-1][0]))

    @cached_property
    def _spline(self) -> CubicSpline:
        table = np.array(self.points)
        return CubicSpline(table[:, 0], table[:, 1:], bc_type='clamped')


@dataclass(frozen=True)
class Steps:
    """A circle in steps, such as that of a loudspeaker carried around a tripod.

    Parameters:
        center (m, ENU): centre.
        radius (m): radius of the circle.
        step_deg (deg): angle of one step.
        dwell (s): time at rest at each position.
        move (s): time from one position to the next.
        start_deg (deg): angle of the first position, counter-clockwise from east.
    """

    center: Vector
    radius: float = bounded(3.0, above=0.0)
    step_deg: float = 20.0
    dwell: float = bounded(4.0, low=0.0)
    move: float = bounded(1.0, above=0.0)
    start_deg: float = 0.0

    def __call__(self, times: ArrayLike) -> NDArray:
        """Positions (k, 3) at times (k,)."""
        steps, within = np.divmod(np.atleast_1d(np.asarray(times, float)), self.dwell + self.move)
        moved = np.clip((within - self.dwell) / self.move, 0.0, 1.0)
        smooth = moved**2 * (3 - 2 * moved)
        angle = np.deg2rad(self.start_deg + self.step_deg * (steps + smooth))
        flat = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
        return np.array(self.center) + self.radius * flat


@dataclass(frozen=True)
class RandomFlight:
    """A smooth random flight inside a box.

    Parameters:
        center (m, ENU): centre of the box.
        extent (m): half extents of the box.
        period (s): approximate time scale of the motion.
        seed: seed of the flight.
    """

    center: Vector
    extent: Vector = (10.0, 10.0, 2.0)
    period: float = bounded(12.0, above=0.0)
    seed: int = bounded(1, low=0)

    def __call__(self, times: ArrayLike) -> NDArray:
        """Positions (k, 3) at times (k,)."""
        t = np.atleast_1d(np.asarray(times, float))[:, np.newaxis, np.newaxis]
        amplitude, rate, phase = self._terms
        return np.array(self.center) + (amplitude * np.sin(rate * t + phase)).sum(axis=1)

    @cached_property
    def _terms(self) -> tuple[NDArray, NDArray, NDArray]:
        """Amplitudes (m), angular frequencies (rad/s) and phases (rad) of the sines along each axis, each (4, 3)."""
        random = np.random.default_rng(self.seed)
        amplitude = random.random((4, 3))
        return (amplitude / amplitude.sum(axis=0) * np.array(self.extent),
                2 * np.pi / self.period * random.uniform(0.3, 1.0, (4, 3)), random.uniform(0.0, 2 * np.pi, (4, 3)))


TRAJECTORIES = {'static': Static, 'line': Line, 'circle': Circle, 'figure_eight': FigureEight,
                'waypoints': Waypoints, 'steps': Steps, 'random': RandomFlight}
Trajectory = Annotated[Any, TRAJECTORIES]
Position = Callable[[NDArray], NDArray]


def velocity(position: Position, times: ArrayLike) -> NDArray:
    """Velocities (m/s, (k, 3)) along a trajectory, by central differences.

    Parameters:
        position: the trajectory.
        times (s, (k,)): times.
    """
    t = np.atleast_1d(np.asarray(times, float))
    step = 1e-3    # s
    return (position(t + step) - position(t - step)) / (2 * step)


def acceleration(position: Position, times: ArrayLike) -> NDArray:
    """Accelerations (m/s^2, (k, 3)) along a trajectory, by central differences.

    Parameters:
        position: the trajectory.
        times (s, (k,)): times.
    """
    t = np.atleast_1d(np.asarray(times, float))
    step = 5e-3    # s
    return (position(t + step) - 2 * position(t) + position(t - step)) / step**2
