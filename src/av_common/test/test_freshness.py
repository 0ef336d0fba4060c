"""An input stays fresh by new data only."""

from __future__ import annotations

import math

import pytest

from av_common.freshness import CaptureClock, FreshInput, Instant

START = 1.7e9


def at(time: float, ros: float | None = None) -> Instant:
    return Instant(50.0 + time, START + (time if ros is None else ros))


def test_ages_count_from_arrival_and_from_capture():
    """Data 0.9 s old on arrival counts as 0.2 s old, where a latency of 0.7 s is allowed for."""
    data = FreshInput(latency=0.7)
    assert data.age(at(0.0)) == math.inf
    assert data.take(START - 0.05, at(0.0))
    assert data.age(at(0.1)) == pytest.approx(0.1)
    assert data.take(START + 0.1, at(1.0))
    assert data.age(at(1.0)) == pytest.approx(0.2, abs=1e-6)


@pytest.mark.parametrize('stamps', [lambda t: 0.0, lambda t: -t, lambda t: 5.0 - t, lambda t: 1e9, lambda t: math.nan,
                                    lambda t: math.inf, lambda t: -math.inf, lambda t: t + 0.2])
def test_only_advancing_stamps_of_the_past_keep_it_fresh(stamps):
    """Repeated, older, future and impossible stamps do not."""
    data = FreshInput(latency=0.7)
    assert data.take(START, at(0.0))
    for k in range(1, 60):
        data.take(START + stamps(0.05 * k), at(0.05 * k))
    assert data.age(at(3.0)) > 2.9


def test_a_stamp_from_the_future_that_is_repeated_never_becomes_new():
    """It was sent before it can have been captured; also when other messages arrive between."""
    data = FreshInput(latency=0.7)
    for k in range(200):
        data.take(START + 3.0, at(0.05 * k))
        assert data.age(at(0.05 * k)) == math.inf


@pytest.mark.parametrize('step', [-3600.0, -0.5, 0.5, 3600.0])
def test_a_step_of_the_clock_renews_nothing(step):
    """Neither a step forth or back nor both; data with advancing stamps is back after 1.1 s at the latest."""
    data = FreshInput(latency=0.7)
    assert data.take(START, at(0.0))
    for k in range(60):
        time = 0.4 + 0.05 * k
        data.take(START, at(time, time + (step if k % 2 else 0.0)))
        assert data.age(at(time)) >= time - 1e-6
    for k in range(60):
        time = 5.0 + 0.05 * k
        data.take(START + time + step, at(time, time + step))
    assert data.age(at(time, time + step)) < 0.1


def test_a_stamp_from_the_future_never_becomes_new_however_rarely_it_is_repeated():
    data = FreshInput(latency=0.7)
    for k in range(10):
        data.take(START + 3.0, at(1.2 * k))
        assert data.age(at(1.2 * k)) == math.inf and data.refused == min(k + 1, 3)


@pytest.mark.parametrize('note', [FreshInput.take, FreshInput.skip])
def test_a_stamp_from_the_future_is_not_forgotten_beside_an_input_of_100_hz(note):
    """Its time comes 3 s and 300 other messages later."""
    data = FreshInput()
    note(data, START + 3.0, at(0.0))
    for k in range(1, 300):
        data.take(START + 0.01 * k, at(0.01 * k))
    assert data.age(at(2.995)) < 0.01
    assert not data.take(START + 3.0, at(3.0))


@pytest.mark.parametrize('how', ['used', 'late', 'skipped'])
def test_what_arrived_before_a_step_back_is_not_new_when_its_time_comes_again(how):
    """Used then, older than another one then, or of a contested input."""
    data = FreshInput()
    assert data.take(START - 0.9, at(0.0))
    getattr(data, 'skip' if how == 'skipped' else 'take')(START + (-1.5 if how == 'late' else 0.1), at(0.2))
    repeated, step = START + (-1.5 if how == 'late' else 0.1), -3.0
    data.take(START + 0.3 + step, at(0.3, 0.3 + step))
    time = repeated - START - step + 0.01
    assert not data.take(repeated, at(time, time + step))
    assert data.take(repeated + 0.005, at(time, time + step)) and data.age(at(time, time + step)) < 0.01


def test_after_a_step_back_the_data_of_the_new_time_counts():
    """Although its stamps are earlier than those before."""
    data = FreshInput()
    for k in range(200):
        time = 0.05 * k
        step = 0.0 if k < 100 else -3600.0
        data.take(START + time + step, at(time, time + step))
        assert k < 100 or k > 120 or data.age(at(time)) > 0.05 * (k - 100)
    assert data.age(at(time)) == 0.0 and data.refused == 1


def test_what_was_captured_before_the_clock_stepped_forth_is_not_new():
    """Its stamp is later than that of data captured after it; what is captured later counts at once."""
    data = FreshInput(latency=math.inf)
    assert data.captured_age(at(0.0)) == math.inf
    assert data.take(START - 0.1, at(0.0)) and data.captured_age(at(0.2)) == pytest.approx(0.3, abs=1e-6)
    assert not data.take(START + 2.25 - 0.9, at(0.25, 2.25)) and data.age(at(0.25, 2.25)) == 0.25
    assert data.take(START + 2.3 - 0.1, at(0.3, 2.3)) and data.age(at(0.3, 2.3)) == 0.0


@pytest.mark.parametrize('steps', [[0.1], [0.1, 0.1, 0.1], [0.05] * 8, [-2.0, 0.09, 0.09]])
def test_steps_back_that_nobody_notices_make_nothing_newer(steps):
    """A node looks at its clocks 50 times a second while its clock is set back; what was captured before is as old as it is."""
    clock, behind, captured = CaptureClock(), 0.0, {}
    data = FreshInput(math.inf, clock)
    for k in range(50):
        time = 0.02 * k
        if k % 5 == 4 and steps:
            behind += steps.pop()
        now = at(time, time - behind)
        clock.note(now)
        captured[k] = now.ros
        if k >= 25:
            assert clock.captured(captured[k - 25], now) <= 50.0 + time - 0.5 + 1e-6
            data.take(captured[k - 25], now)
            assert data.captured_age(now) >= 0.5 - 1e-6
    for k in range(50, 120):
        clock.note(at(0.02 * k, 0.02 * k - behind))
    assert clock.captured(now.ros + 1.0, at(2.4, 2.4 - behind)) == pytest.approx(50.0 + time + 1.0, abs=1e-6)


@pytest.mark.parametrize('rate', [0.25, 0.5, 0.75, 2.0])
def test_slow_and_fast_simulated_time_make_nothing_older_or_newer(rate):
    """What was captured 0.3 s ago is so old, whatever the simulated clock counted since."""
    clock = CaptureClock()
    data = FreshInput(math.inf, clock)
    for k in range(150):
        now = at(0.02 * k, rate * 0.02 * k)
        clock.note(now)
        if k >= 15:
            assert data.take(START + rate * 0.02 * (k - 15), now)
            assert data.captured_age(now) == pytest.approx(0.3, abs=1e-6)
