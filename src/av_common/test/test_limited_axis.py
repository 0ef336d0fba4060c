"""One axis arrives without overshoot, and limits that hold no motion are refused."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from av_common.limited_axis import AxisLimits, LimitedAxis


@given(st.floats(-3.0, 3.0), st.floats(0.2, 4.0), st.floats(0.5, 20.0))
@settings(max_examples=100, deadline=None)
def test_an_axis_arrives_without_overshoot(target, rate, acceleration):
    """At rest, within the time that a trapezoidal profile with a third of the acceleration needs."""
    axis = LimitedAxis(AxisLimits(rate, acceleration))
    needed = abs(target) / rate + 2.0 * (abs(target) / (acceleration / 3.0)) ** 0.5 + 2.0
    for _ in range(int(needed / 0.02)):
        axis.follow(target - axis.position, 0.0, 0.02)
        assert abs(axis.position) <= abs(target) + 0.02 * abs(axis.velocity) + 1e-6
    assert axis.position == pytest.approx(target, abs=0.02)


@pytest.mark.parametrize('change', [{'rate': 0.0}, {'acceleration': -1.0}, {'lower': 0.1}, {'upper': -0.1}])
def test_impossible_limits_are_refused(change):
    """Limits that hold no motion or exclude neutral are named."""
    with pytest.raises(ValueError, match='axis limits'):
        AxisLimits(**{'rate': 1.0, 'acceleration': 1.0, **change})
