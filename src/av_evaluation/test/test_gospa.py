"""GOSPA and identity switches against values by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_evaluation.metrics.tracks import IdentitySwitches, angles_between, gospa

CUTOFF = 10.0


def test_parts_by_hand():
    """Two pairs 3 and 4 apart, one target missed: 9 + 16 + 100 / 2."""
    found = gospa(np.array([[3.0, 50.0], [50.0, 4.0], [50.0, 50.0]]), CUTOFF)
    assert found.distance == pytest.approx(math.sqrt(9.0 + 16.0 + 50.0))
    assert (found.localisation, found.missed, found.false) == (25.0, 50.0, 0.0)
    assert found.assigned == ((0, 0), (1, 1))


@pytest.mark.parametrize(('shape', 'missed', 'false'), [((0, 0), 0.0, 0.0), ((2, 0), 100.0, 0.0), ((0, 3), 0.0, 150.0)])
def test_empty_sets_cost_half_of_the_cutoff_each(shape, missed, false):
    """Only targets, only tracks, or neither."""
    assert gospa(np.zeros(shape), CUTOFF)[1:4] == (0.0, missed, false)


def test_a_pair_beyond_the_cutoff_is_missed_and_false():
    """It costs as much as the target and the track alone."""
    assert gospa(np.array([[10.1]]), CUTOFF) == (10.0, 0.0, 50.0, 50.0, ())


def test_angles_between_directions():
    """A right angle, and the same direction."""
    axes = np.eye(3)
    assert np.allclose(angles_between(axes[:1], axes), [[0.0, 0.5 * math.pi, 0.5 * math.pi]])
    assert angles_between(axes, np.zeros((0,))).shape == (3, 0)


def test_a_correspondence_is_kept_while_it_is_valid():
    """A nearer track does not take over; one that follows after the first has gone is a switch, and so is an exchange."""
    switches = IdentitySwitches(5.0)
    switches.add(np.array([[1.0]]), ['a'])
    switches.add(np.array([[4.0, 1.0]]), ['a', 'b'])
    assert switches.count == 0
    switches.add(np.array([[1.0]]), ['b'])
    assert switches.count == 1
    switches.add(np.zeros((1, 0)), [])
    switches.add(np.array([[1.0]]), ['b'])  # it was lost for a while, under its own name
    assert switches.count == 1


def test_two_exchanged_names_are_two_switches():
    """After a crossing each target is followed by the other's track."""
    switches = IdentitySwitches(5.0)
    switches.add(np.array([[1.0, 20.0], [20.0, 1.0]]), [1, 2])
    switches.add(np.array([[20.0, 1.0], [1.0, 20.0]]), [1, 2])
    assert switches.count == 2
