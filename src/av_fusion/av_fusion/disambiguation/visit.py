"""Plans in which order a gimbal turns the camera to several targets, so that the sum of their uncertainties stays low."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from av_common.angles import angles_to_direction
from av_common.gimbal_geometry import gimbal_to_mount
from av_common.rig import GimbalMount
from av_fusion.disambiguation.gimbal_reach import GimbalReach, Matrix
from av_fusion.disambiguation.look import ARRIVAL_S, OVERHEAD_S, REST_S, Sight, in_view

SIGHT_VARIANCE = math.radians(0.5) ** 2  # rad^2 across and up together, that a visit leaves


class VisitedTarget(NamedTuple):
    """A target that the camera may visit.

    Parameters:
        id: its id.
        azimuth, elevation (rad): direction in the world.
        variance (rad^2): of the direction, across and up together.
        growth (rad^2/s, rad^2/s^2): coefficients by which the variance grows linearly and with the square of time.
        existence: probability that it exists, which weighs its variance.
        visible: probability that the camera finds it when it looks there.
        newest_sighting (s): when it was seen last.
    """

    id: int
    azimuth: float
    elevation: float
    variance: float
    growth: tuple[float, float] = (0.0, 0.0)
    existence: float = 1.0
    visible: float = 1.0
    newest_sighting: float = -math.inf

    def reduction(self, seconds: Matrix) -> Matrix:
        """Variance (rad^2) that a look `seconds` from now is expected to remove, weighted by existence."""
        linear, square = self.growth
        later = self.variance + linear * seconds + square * seconds**2
        return np.asarray(self.existence * self.visible * np.maximum(later - SIGHT_VARIANCE, 0.0))


class VisitPlanner:
    """Visits the target, and what is in view beside it, by which the variance falls most for the time that it takes.

    The greedy policy of sensor management with one step of look-ahead (Hero and Cochran, Sensor management: past, present,
    and future, IEEE Sensors Journal 11(12), 2011). A visit lasts from the first image with the target in view for `dwell`. A
    target that is not seen meanwhile is not visited again for REST_S.

    Parameters:
        gimbal: carries the camera.
        dwell (s): duration of a visit.
    """

    def __init__(self, gimbal: GimbalMount, dwell: float) -> None:
        self._reach, self._dwell = GimbalReach(gimbal), dwell
        self.cancel()

    def cancel(self) -> None:
        """Begin anew."""
        self._visited = 0
        self._due = self._arrived = math.inf
        self._rests: dict[int, float] = {}  # until when targets are not visited, by their ids

    def plan(self, time: float, targets: Sequence[VisitedTarget], sight: Sight | None, mount_in_world: Matrix) -> Matrix | None:
        """Direction (3,) in the world to look at; None without a target to visit.

        Parameters:
            time (s): time of the request.
            targets: those that may be visited.
            sight: of the newest image; None without one.
            mount_in_world (3, 3): rotation matrix from the gimbal's mount to the world.
        """
        self._rests = {key: until for key, until in self._rests.items() if time < until <= time + REST_S}
        if sight is None or not targets:
            self.cancel()
            return None
        known = {target.id: target for target in targets}
        directions = {key: angles_to_direction(target.azimuth, target.elevation) for key, target in known.items()}
        if self._visited not in known or self._is_over(time, known[self._visited], directions[self._visited], sight):
            open_targets = [target for target in targets if target.id not in self._rests]
            self._visited, way = self._best(open_targets, directions, sight, mount_in_world)
            self._due, self._arrived = time + way + ARRIVAL_S, math.inf
        return directions.get(self._visited)

    def _is_over(self, time: float, target: VisitedTarget, direction: Matrix, sight: Sight) -> bool:
        """Whether the visit has lasted long enough, or the target cannot be reached; notes when it came into view."""
        if in_view(direction[None], sight.camera_in_world, sight.half_view, sight.half_height)[0]:
            self._arrived = min(self._arrived, sight.time)
        elif math.isinf(self._arrived):
            if time > self._due:
                self._rests[target.id] = time + REST_S
            return time > self._due
        over = time - self._arrived >= self._dwell
        if over and target.newest_sighting < self._arrived:
            self._rests[target.id] = time + REST_S
        return over

    def _best(self, targets: Sequence[VisitedTarget], directions: dict[int, Matrix], sight: Sight, mount_in_world: Matrix
              ) -> tuple[int, float]:
        """The target to visit next, 0 for none, and the time (s) of the way."""
        if not targets:
            return 0, 0.0
        points = np.array([directions[target.id] for target in targets])
        looks = np.array([self._reach.nearest(point) for point in points @ mount_in_world])
        way = self._reach.times(looks, self._reach.nearest(sight.camera_in_world[:, 0] @ mount_in_world))
        seen = np.array([in_view(points, mount_in_world @ gimbal_to_mount(pan, tilt), sight.half_view, sight.half_height)
                         for pan, tilt in looks])  # (looks, targets)
        reductions = np.array([target.reduction(way + OVERHEAD_S) for target in targets]).T
        rates = np.where(np.diag(seen) > 0.0, (seen * reductions).sum(axis=1) / (way + OVERHEAD_S + self._dwell), -math.inf)
        best = int(np.argmax(rates))
        return (targets[best].id, float(way[best])) if rates[best] > 0.0 else (0, 0.0)
