"""The scale of the process noise follows the innovations."""

from __future__ import annotations

import math

import pytest

from av_fusion.filter.process_noise import LEAST, ONE_OF_SEVERAL, ONLY, AdaptiveProcessNoise


def after(measurements, nis, rate, noise=None):
    """The scale after independent measurements of this normalised innovation squared."""
    noise = noise or AdaptiveProcessNoise()
    for _ in range(measurements):
        noise.note(1.0, rate, nis**0.5, 1.0)
        noise.adapt(1.0)
    return noise


def test_large_innovations_raise_it_at_once_and_small_ones_lower_it():
    """Three sigma once is enough; it falls to 1 within ten small innovations."""
    manoeuvring = after(1, 9.0, 0.2)
    assert manoeuvring.value == ONLY.largest
    assert after(10, 0.5, 0.0, manoeuvring).value == pytest.approx(1.0)


def test_only_long_steady_motion_lowers_it_below_one():
    """Four measurements change little, a hundred much; a hovering target changes nothing, a large innovation ends it."""
    assert after(4, 0.5, 0.2).value > 0.7
    steady = after(100, 0.5, 0.2)
    assert steady.value == LEAST
    assert after(100, 0.5, 0.0).value == 1.0
    assert after(1, 9.0, 0.2, steady).value == ONLY.largest


def test_among_several_slow_motion_is_steady_too_and_a_manoeuvre_is_noticed_sooner():
    """At 3 deg/s the scale falls to less than half of that of an only target, and rises to more by one window of two."""
    only, several = AdaptiveProcessNoise(), AdaptiveProcessNoise()
    several.adaptation = ONE_OF_SEVERAL
    rate = math.radians(3.0)
    assert after(20, 0.5, rate, several).value < 0.5 * after(20, 0.5, rate, only).value
    factors = []
    for noise in (only, several):
        before = noise.value
        noise.note(1.0, rate, 2.0**0.5, 1.0)
        noise.adapt(0.2)
        factors.append(noise.value / before)
    assert factors == [pytest.approx(math.exp(0.2 * gain)) for gain in (3.0, 8.0)]


def test_steadiness_counts_little_where_a_turn_could_be_heard():
    """Long steady motion lowers the noise of an only target that is heard to a half, and to the least close to end-fire."""
    noise = after(100, 0.5, 0.2)
    assert noise.least(in_view=False) == ONLY.least_heard > noise.least(in_view=True) > noise.value
    noise.note(1.0, 0.2, 0.5, 1.0, slope=math.sin(math.radians(10.0)))
    noise.adapt(1.0)
    assert noise.least(in_view=False) == LEAST
