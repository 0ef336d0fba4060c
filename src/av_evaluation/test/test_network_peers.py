"""JPDA of Stone Soup, with which the network is compared."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_evaluation.network import cases
from av_evaluation.network.figures import run

pytest.importorskip('stonesoup')


def test_what_a_rig_receives_is_where_the_target_was():
    """The delay by fixed-point iteration, derivatives by Stone Soup's differences."""
    from stonesoup.functions import jacobian
    from stonesoup.types.array import StateVector
    from stonesoup.types.state import GaussianState

    from av_evaluation.network.stone_soup import _Apparent

    origin, place, velocity = np.array([2.0, -1.0, 1.5]), np.array([30.0, 80.0, 25.0]), np.array([-18.0, 9.0, 3.0])
    model = _Apparent(6, [0, 2, 4], np.eye(2), translation_offset=StateVector(origin), speed=343.2)
    state = GaussianState(StateVector(np.stack([place, velocity], 1).ravel()), np.eye(6))
    delay = 0.0
    for _ in range(30):
        delay = float(np.linalg.norm(place - velocity * delay - origin)) / 343.2
    d = place - velocity * delay - origin
    assert np.allclose(np.array(model.function(state), float).ravel(),
                       [math.atan2(d[2], math.hypot(d[0], d[1])), math.atan2(d[1], d[0])], atol=1e-9)
    assert np.allclose(np.array(model.jacobian(state), float), np.array(jacobian(model.function, state), float), atol=1e-5)


def test_jpda_follows_one_drone():
    """Two rigs that see it: one track, within 2 m."""
    from av_evaluation.network.stone_soup import StoneSoupJpda

    simulation = cases.two_rigs(5)
    simulation.duration = 8.0
    found = run(StoneSoupJpda(cases.settings_of(simulation)), simulation)
    assert len(found.estimates[-1]) == 1 and found.rmse(5.0) < 2.0
