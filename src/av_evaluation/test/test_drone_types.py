"""Rendered drones are named by their sound."""

from __future__ import annotations

import numpy as np
import pytest

from av_evaluation.cli.drone_types import Flight, fly


@pytest.mark.parametrize('profile', ['hexarotor', 'mini_quadrotor'])
def test_a_track_has_the_type_of_the_drone_that_was_rendered(profile):
    """In fog, at a random place, with noise: the fundamental is that of the profile's rotors."""
    flight = fly(profile, 21, 5.0)
    assert flight.named == profile
    assert flight.right > 0.5


def test_fundamentals_that_are_not_known_do_not_count():
    """Two of three known ones are right."""
    assert Flight('any', '', np.array([np.nan, 100.0, 104.0, 200.0]), 100.0).right == pytest.approx(2.0 / 3.0)
