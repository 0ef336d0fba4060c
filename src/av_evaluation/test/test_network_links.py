"""A network of rigs whose messages are late, lost, or kept from the other side for a while."""

from __future__ import annotations

import numpy as np
import pytest

from av_evaluation.metrics.tracks import gospa
from av_evaluation.network import cases
from av_evaluation.network.figures import CUTOFF_M, OwnTracker, run
from av_evaluation.network.simulation import LinkModel, NetworkSimulation, RigModel

PAIRS = {'first': ((-20.0, 0.0), (20.0, 0.0)), 'second': ((-20.0, 35.0), (20.0, 35.0))}    # m
BEGIN, END = 15.0, 25.0    # s, for which neither pair hears of the other one


@pytest.fixture(scope='module', params=[1, 2])
def parted(request):
    """The runs of a node beside each pair of rigs, with 0.2 s of delay and a fifth of the messages lost."""
    random = np.random.default_rng(1000 + request.param)
    rigs = [RigModel(f'{pair} {k}', (*place, 1.5)) for pair, places in PAIRS.items() for k, place in enumerate(places)]
    drones = [cases.flight((random.uniform(-35.0, 35.0), random.uniform(5.0, 75.0), random.uniform(10.0, 30.0)), 100 + drone)
              for drone in range(3)]
    simulation = NetworkSimulation(rigs, drones, 40.0, request.param, link=LinkModel(0.2, 0.02, 0.2))
    arrivals = simulation.arrivals()
    return [run(OwnTracker(cases.settings_of(simulation)), simulation, [
        each for each in arrivals if each.report.rig.startswith(pair) or not BEGIN <= each.time < END]) for pair in PAIRS]


def test_each_side_of_a_partition_goes_on(parted):
    """No track is lost, and hardly a drone is without one."""
    for each in parted:
        begin, end = np.searchsorted(each.times, (BEGIN, END))
        names = [{one.target.id for one in found} for found in each.estimates]
        assert not names[begin] - set().union(*names[end:end + 20])
        assert np.mean([min(len(found), 3) for found in each.estimates[begin:end]]) > 3.0 * 0.9
        assert each.rmse(10.0) < 0.5 * CUTOFF_M


def test_both_sides_of_a_partition_agree_for_good_within_two_seconds(parted):
    """As many targets, the sum of whose squared distances is 25 m^2 at most."""
    for time, *pictures in zip(parted[0].times, *(each.estimates for each in parted), strict=True):
        if time > END + 2.0:
            one, other = (np.array([state.mean[:3] for state in picture]).reshape(-1, 3) for picture in pictures)
            assert gospa(np.linalg.norm(one[:, None] - other, axis=2), CUTOFF_M).distance <= 5.0


def test_the_order_of_arrival_does_not_matter():
    """Two nodes that get the same reports in another order have the same tracks with the same ids."""
    simulation = cases.five_drones(3, 1.0, 2)
    arrivals = [each for each in simulation.arrivals() if each.time < 6.0]
    late = sorted((each._replace(time=each.time + 0.2 * (each.report.rig == 'b')) for each in arrivals),
                  key=lambda each: each.time)
    pictures = []
    for each in (arrivals, late):
        peer = OwnTracker(cases.settings_of(simulation))
        for arrival in each:
            peer.take(arrival.report)
            peer.estimates(arrival.time)
        pictures.append(peer.estimates(7.0))
    assert [one.target.id for one in pictures[0]] == [one.target.id for one in pictures[1]] and pictures[0]
    for one, other in zip(*pictures, strict=True):
        assert np.allclose(one.mean, other.mean, atol=1e-9)
