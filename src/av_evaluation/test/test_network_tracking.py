"""Positions by several rigs on simulated reports."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from av_evaluation.network import cases
from av_evaluation.network.figures import (
    OwnTracker,
    follow,
    least_squares,
    mean_bound,
    nees_bounds,
    position_bound,
    run,
)
from av_evaluation.network.simulation import LinkModel, NetworkSimulation, RigModel
from av_network.observation import Report, Sighting


def test_bound_of_two_crossing_directions_by_hand():
    """Directions that cross at a right angle in a horizontal plane: range times error along each axis, and half in height."""
    one, two = (Report(name, 0.0, place, (Sighting(1, 0.0, 0.0, np.eye(2) * 0.01**2, 0.0),))
                for name, place in (('a', np.array([0.0, -50.0, 0.0])), ('b', np.array([-50.0, 0.0, 0.0]))))
    assert position_bound(np.zeros(3), [one, two]) == pytest.approx(math.sqrt(0.25 + 0.25 + 0.125))
    assert position_bound(np.zeros(3), [one]) == math.inf


@pytest.mark.parametrize('seen', [0.0, 1.0])
def test_error_is_close_to_the_bound(seen):
    """Two rigs and a drone, in three runs."""
    errors, bounds = [], []
    for seed in (11, 12, 13):
        simulation = cases.two_rigs(seed, seen=seen)
        arrivals = simulation.arrivals()
        found = run(OwnTracker(cases.settings_of(simulation)), simulation, arrivals)
        errors.append(found.rmse(10.0))
        bounds.append(mean_bound(simulation, arrivals, 10.0))
    assert np.linalg.norm(errors) < 1.3 * np.linalg.norm(bounds)


@pytest.mark.parametrize('kind, lasting', [('reversals', 0.0), ('eight', 0.0), ('reversals', 0.2), ('eight', 0.2)])
def test_hard_flights_are_followed_as_well_as_by_least_squares(kind, lasting):
    """Stops, reversals and eights: one id, a position while two cameras see, and an honest covariance.

    So, too, where directions have errors that last and that the cameras do not state, and headings are 1 deg off.
    """
    simulation = cases.cameras(31, kind, 30.0, lasting=math.radians(lasting), heading=math.radians(5.0 * lasting))
    heading = math.radians(3.0 if lasting else 0.3)
    found = follow(OwnTracker(cases.settings_of(simulation, heading, 0.02)), simulation)
    assert found.rmse < 1.2 * found.squares and found.rmse < 0.6
    assert found.coverage >= 0.98 and found.names == 1 and 1.5 < found.nees < 4.5


def test_least_squares_finds_a_drone_in_uniform_motion():
    """From directions without errors, at the newest time."""
    begin, velocity, reports = np.array([3.0, 40.0, 12.0]), np.array([6.0, -2.0, 1.0]), []
    for k, place in enumerate(np.array([[-30.0, 0.0, 1.0], [30.0, 0.0, 2.0], [0.0, 80.0, 1.0]] * 2)):
        time = 0.1 * k
        x, y, z = begin + velocity * time - place
        one = Sighting(1, math.atan2(y, x), math.atan2(z, math.hypot(x, y)), np.eye(2) * 1e-4, time)
        reports.append(Report('abc'[k % 3], time, place, (one,)))
    found = least_squares(reports, 0.6)
    assert found.time == 0.5 and np.allclose(found.position, begin + 0.5 * velocity)
    assert least_squares(reports[:4], 0.6) is None


def test_bounds_of_the_nees_hold_in_95_percent():
    """Runs of a consistent filter, whose errors are those of some four independent samples each."""
    random = np.random.default_rng(5)
    means = random.chisquare(3 * 4, (4000, 8)) / 4
    inside = [low <= np.mean(each) <= high for each in means for low, high in [nees_bounds(each)]]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)
    assert nees_bounds([2.0]) == (0.0, math.inf)


def test_headings_and_clocks_are_found():
    """Headings within 0.5 deg; clocks as far as their stated deviations say."""
    simulation = replace(cases.wrong_clocks(21), duration=41.0)
    peer = OwnTracker(cases.settings_of(simulation, math.radians(3.0), 0.05))
    run(peer, simulation)
    for index, rig in enumerate(simulation.rigs):
        known = peer.tracker.calibration.known(index)
        assert abs(known.heading - rig.heading_error) < math.radians(0.5)
        assert abs(known.clock - rig.clock_offset) < 4.0 * known.clock_sigma < 0.05


SQUARE = ((-20.0, 0.0), (20.0, 0.0), (-20.0, 35.0), (20.0, 35.0))    # m


def square_of_rigs(seed):
    rigs = [RigModel(f'rig{number}', (*place, 1.5)) for number, place in enumerate(SQUARE, 1)]
    drones = [cases.flight((20.0 * side, 40.0, 20.0), seed + side) for side in (-1, 1)]
    return NetworkSimulation(rigs, drones, 45.0, seed, link=LinkModel(0.0, 0.0))


def attacked(kind, seed):
    """Reports of four rigs, of which the last one is wrong from 10 to 25 s."""
    simulation, random = square_of_rigs(seed), np.random.default_rng(seed)
    for time, report in simulation.arrivals():
        sightings = report.sightings
        if report.rig == 'rig4' and 10.0 < time < 25.0:
            if kind == 'turned':
                sightings = [one._replace(azimuth=math.remainder(one.azimuth + 0.5, math.tau)) for one in sightings]
            else:
                places = random.uniform([-3.0, 0.0], [3.0, 1.0], (48, 2))
                sightings = [*sightings, *(Sighting(int(random.integers(1000, 10**9)), *place, np.eye(2) * 1e-5, report.time)
                                           for place in places)]
        yield time, report._replace(sightings=tuple(sightings))


@pytest.mark.parametrize('kind', ['turned', 'forged'])
def test_a_rig_that_contradicts_all_others_is_left_out_and_let_in_again(kind):
    """Both drones keep their positions: the wrong rig is found out within 8 s, and used again within 8 s of being right."""
    simulation, waiting, out, found = square_of_rigs(33), list(attacked(kind, 33))[::-1], [], []
    peer = OwnTracker(cases.settings_of(simulation, math.radians(3.0)))
    for now in np.arange(0.1, 44.0, 0.1).tolist():
        while waiting and waiting[-1][0] <= now:
            peer.take(waiting.pop()[1])
        places = [one.mean[:3] for one in peer.estimates(now)]
        found.append([any(np.linalg.norm(place - drone) < 8.0 for place in places) for drone in simulation.truth(now)])
        out.append([rig for name, rig in peer.tracker.rigs.items() if rig not in peer.tracker.trust])
    assert np.mean(found[60:]) > 0.9
    assert not any(out[:100]) and all(rigs == [3] for rigs in out[180:245]) and not any(out[330:])
