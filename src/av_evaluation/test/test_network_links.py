"""A network of rigs whose messages are late, lost, or kept from the other side for a while."""

from __future__ import annotations

import numpy as np
import pytest

from av_evaluation.network import cases
from av_evaluation.network.figures import CUTOFF_M, Estimate, OwnTracker, agree, partition_figures, run


def estimate(*place):
    return Estimate(1, np.array([*place, 0.0, 0.0, 0.0]), np.eye(6))


def test_pictures_agree_where_each_has_what_the_other_has():
    """As many targets, each near one of its own in the other picture."""
    assert agree([], []) and agree([estimate(1.0, 2.0, 3.0)], [estimate(2.0, 2.0, 3.0)])
    assert not agree([estimate(1.0, 2.0, 3.0)], [])
    assert agree([estimate(0.0, 0.0, 0.0), estimate(50.0, 0.0, 0.0)], [estimate(50.0, 0.0, 3.0), estimate(0.0, 3.0, 0.0)])
    assert not agree([estimate(0.0, 0.0, 0.0), estimate(50.0, 0.0, 0.0)], [estimate(50.0, 0.0, 4.0), estimate(0.0, 4.0, 0.0)])
    assert not agree([estimate(0.0, 0.0, 0.0), estimate(1.0, 0.0, 0.0)], [estimate(0.0, 0.0, 0.0), estimate(50.0, 0.0, 0.0)])


@pytest.fixture(scope='module', params=[1, 2])
def parted(request):
    """The runs of two nodes with 0.2 s of delay and a fifth of the messages lost, and what a partition does to them."""
    runs = [run(OwnTracker(cases.settings_of(each)), each) for each in cases.parted_pairs(request.param)]
    return runs, partition_figures(*runs, *cases.PARTITION)


def test_each_side_of_a_partition_goes_on(parted):
    runs, found = parted
    assert found.lost == 0 and found.missed < 0.1
    for each in runs:
        assert each.rmse(10.0) < 0.5 * CUTOFF_M


def test_both_sides_of_a_partition_agree_for_good_within_two_seconds(parted):
    assert parted[1].healed <= 2.0


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
    assert [one.id for one in pictures[0]] == [one.id for one in pictures[1]] and pictures[0]
    for one, other in zip(*pictures, strict=True):
        assert np.allclose(one.mean, other.mean, atol=1e-9)
