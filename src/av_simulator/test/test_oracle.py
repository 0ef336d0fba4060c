"""Lines of sight past solids whose shadows are known."""

from __future__ import annotations

import numpy as np
import pytest

from av_simulator.rendering.oracle import Solids
from av_simulator.rendering.scenes import Solid

EYE = np.array([0.0, 0.0, 1.0])


def hides(solid, *points):
    return Solids([solid]).hide(EYE, np.array(points, float)).tolist()


@pytest.mark.parametrize(('shape', 'z', 'hidden'), [
    ('box', 0.95, True), ('box', -0.95, True), ('cylinder', 0.95, True), ('cylinder', 1.05, False),
    ('ellipsoid', 0.95, True), ('ellipsoid', 1.05, False), ('cone', 0.95, True), ('cone', 1.05, False)])
def test_a_solid_hides_up_to_its_top(shape, z, hidden):
    """Solids 10 m away, 1 m to all sides of (10, 0, 1); points right behind, seen along level rays."""
    solid = Solid(shape, (10.0, 0.0, 1.0), (1.0, 1.0, 1.0), (0, 0, 0))
    level = Solids([solid]).hide(np.array([0.0, 0.0, 1.0 + z]), np.array([[20.0, 0.0, 1.0 + z]]))
    assert level.tolist() == [hidden]


def test_round_solids_have_round_sides():
    """At half height the cone is half as wide; the box' corner hides what the cylinder lets pass."""
    def past(shape, y, z=1.0):
        solid = Solid(shape, (10.0, 0.0, 1.0), (1.0, 1.0, 1.0), (0, 0, 0))
        return Solids([solid]).hide(np.array([0.0, y, z]), np.array([[20.0, y, z]])).tolist()
    assert past('cone', 0.48) == [True] and past('cone', 0.52) == [False]
    assert past('cone', 0.9, 0.1) == [True] and past('ellipsoid', 0.9, 0.1) == [False]
    assert past('cylinder', 0.99) == [True] and past('cylinder', 1.01) == [False]
    turned = Solid('box', (10.0, 0.0, 1.0), (1.0, 1.0, 1.0), (0, 0, 0), np.pi / 4)
    assert hides(turned, [20.0, 2.7, 1.0], [20.0, 2.9, 1.0]) == [True, False]


def test_nothing_hides_what_stands_before_it_or_elsewhere():
    solid = Solid('box', (10.0, 0.0, 1.0), (1.0, 1.0, 1.0), (0, 0, 0))
    assert hides(solid, [8.9, 0.0, 1.0], [-20.0, 0.0, 1.0], [9.5, 0.0, 1.0], [20.0, 0.0, 1.0]) == [False, False, True, True]
    assert Solids([]).hide(EYE, np.zeros((2, 3))).tolist() == [False, False]
