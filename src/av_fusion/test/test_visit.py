"""Visits of several targets: their order keeps the sum of variances low, and each lasts its time."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from av_common.angles import direction_to_angles, wrap
from av_common.gimbal_geometry import gimbal_to_body
from av_common.rig import GimbalMount
from av_fusion.disambiguation.look import REST_S, Sight
from av_fusion.disambiguation.visit import SIGHT_VARIANCE, VisitedTarget, VisitPlanner

GIMBAL = GimbalMount(pan_limits_deg=(-180.0, 180.0), tilt_limits_deg=(-45.0, 60.0), max_rate_deg=120.0)
STEP, DWELL = 0.1, 1.0
FAR = {1: 0.0, 2: 100.0, 3: -100.0}  # azimuths (deg) of which no view has two


class Watch:
    """Targets whose variances grow evenly, and are small while they are in view of a camera on a gimbal that obeys.

    Parameters:
        azimuths: of the targets (deg), by their ids.
        growth: of the variances (rad^2/s), by id.
        hidden: ids of targets that are never seen.
    """

    def __init__(self, azimuths, growth, hidden=()):
        self.azimuths, self.growth, self.hidden = azimuths, growth, hidden
        self.variances = dict.fromkeys(azimuths, 0.01)
        self.seen = dict.fromkeys(azimuths, -math.inf)
        self.pan, self.time, self.sums, self.visited, self.pans = 0.0, 10.0, [], [], [0.0]

    def targets(self):
        """What the planner is told."""
        return [VisitedTarget(key, math.radians(azimuth), 0.0, self.variances[key], (self.growth[key], 0.0),
                              newest_sighting=self.seen[key]) for key, azimuth in self.azimuths.items()]

    def step(self, wanted):
        """Turn towards an azimuth (deg) for a step."""
        reach = GIMBAL.max_rate_deg * STEP
        if wanted is not None:
            self.pan += float(np.clip(math.degrees(wrap(math.radians(wanted - self.pan))), -reach, reach))
        self.time += STEP
        for key, azimuth in self.azimuths.items():
            self.variances[key] += self.growth[key] * STEP
            if abs(math.degrees(wrap(math.radians(azimuth - self.pan)))) < 30.0 and key not in self.hidden:
                self.variances[key], self.seen[key] = SIGHT_VARIANCE, self.time
        self.sums.append(sum(self.variances.values()))
        self.pans.append(self.pan)

    def run(self, planner, seconds):
        """Let a planner decide; the mean sum of variances."""
        for _ in range(round(seconds / STEP)):
            sight = Sight(self.time, gimbal_to_body(GIMBAL, math.radians(self.pan), 0.0), *np.radians((35.0, 27.0)))
            look = planner.plan(self.time, self.targets(), sight, np.eye(3))
            wanted = None if look is None else math.degrees(direction_to_angles(look)[0])
            if wanted is not None:
                key = min(self.azimuths, key=lambda each: abs(wrap(math.radians(self.azimuths[each] - wanted))))
                if not self.visited or self.visited[-1] != key:
                    self.visited.append(key)
            self.step(wanted)
        return float(np.mean(self.sums))

    def cycle(self, order, seconds):
        """Visit the targets in a fixed order again and again; the mean sum of variances."""
        visits, arrived = itertools.cycle(order), -math.inf
        for _ in range(round(seconds / STEP)):
            if self.time >= arrived + DWELL:
                key, arrived = next(visits), math.inf
            self.step(self.azimuths[key])
            arrived = self.time if math.isinf(arrived) and self.seen[key] == self.time else arrived
        return float(np.mean(self.sums))


@pytest.mark.parametrize('growth', [(0.001, 0.001, 0.001), (0.001, 0.004, 0.001), (0.0002, 0.001, 0.005)])
def test_the_sum_of_variances_is_close_to_that_of_the_best_of_all_cycles(growth):
    """All orders of up to four visits, repeated for 60 s: brute force."""
    rates = dict(zip(FAR, growth, strict=True))
    best = min(Watch(FAR, rates).cycle(order, 60.0) for count in range(1, 5) for order in itertools.product(FAR, repeat=count))
    assert Watch(FAR, rates).run(VisitPlanner(GIMBAL, DWELL), 60.0) < 1.15 * best


def test_visiting_is_better_than_staying_and_uncertain_targets_are_visited_more_often():
    rates = {1: 0.001, 2: 0.001, 3: 0.008}
    watch = Watch(FAR, rates)
    assert watch.run(VisitPlanner(GIMBAL, DWELL), 60.0) < 0.5 * Watch(FAR, rates).cycle((1,), 60.0)
    assert watch.visited.count(3) > 1.5 * watch.visited.count(1)


def test_targets_that_are_in_view_together_are_one_visit():
    """Two at 10 deg from each other count for more than one that is as uncertain as either."""
    watch = Watch({1: 90.0, 2: -85.0, 3: -95.0}, dict.fromkeys((1, 2, 3), 0.002))
    watch.run(VisitPlanner(GIMBAL, DWELL), 0.2)
    assert watch.visited[0] in (2, 3)


def test_a_target_that_does_not_show_waits_and_the_others_are_visited():
    watch = Watch(FAR, {1: 0.001, 2: 0.01, 3: 0.001}, hidden=(2,))
    watch.run(VisitPlanner(GIMBAL, DWELL), 20.0)
    assert watch.visited.count(2) <= 20.0 / REST_S + 1.0
    assert {1, 3} <= set(watch.visited)


def test_visits_last_at_least_their_dwell():
    """Between two turns of the gimbal the picture stands still."""
    watch = Watch(FAR, dict.fromkeys(FAR, 0.002))
    watch.run(VisitPlanner(GIMBAL, DWELL), 30.0)
    still = [sum(1 for _ in group) for moves, group in itertools.groupby(np.abs(np.diff(watch.pans)) > 1e-6) if not moves]
    assert len(still) > 5 and min(still[1:-1]) * STEP > 0.5 * DWELL


def test_without_camera_or_targets_nothing_is_visited():
    planner = VisitPlanner(GIMBAL, DWELL)
    assert planner.plan(1.0, [VisitedTarget(1, 0.0, 0.0, 0.01)], None, np.eye(3)) is None
    assert planner.plan(1.0, [], Sight(1.0, np.eye(3), 0.6, 0.5), np.eye(3)) is None
