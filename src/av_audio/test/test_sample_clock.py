"""The sample clock against a device whose true clock is known."""

import numpy as np
import pytest

from av_audio.sample_clock import FAST_SLEW, SampleClock

RATE, BLOCK = 48_000, 1600


def run(clock, seconds, ppm, jitter_s, seed=0, start=1.7e9):
    """Feed blocks that end at true times plus a one-sided jitter; return stamps and true times of the blocks."""
    rng = np.random.default_rng(seed)
    stamps, truth = [], []
    for k in range(1, round(seconds * RATE / BLOCK)):
        sample = k * BLOCK
        true_time = start + sample / RATE * (1.0 + 1e-6 * ppm)
        clock.observe(sample, true_time + rng.exponential(jitter_s))
        stamps.append(clock.time_of(sample))
        truth.append(true_time)
    return np.array(stamps), np.array(truth)


@pytest.mark.parametrize('ppm', [-120.0, 0.0, 85.0])
@pytest.mark.parametrize('jitter_s', [0.0003, 0.003])
def test_stamps_are_regular_and_drift_is_found(ppm, jitter_s):
    clock = SampleClock(RATE)
    stamps, truth = run(clock, 120.0, ppm, jitter_s)
    # a float of today's epoch resolves 0.24 microseconds
    assert np.abs(np.diff(stamps) - BLOCK / RATE).max() < 1e-4
    settled = slice(len(stamps) // 2, None)
    assert np.std((stamps - truth)[settled]) < 1e-4
    assert clock.ppm == pytest.approx(ppm, abs=10.0)
    assert clock.restarts == 0


def test_without_jitter_the_clock_is_exact():
    clock = SampleClock(RATE)
    stamps, truth = run(clock, 60.0, 50.0, 0.0)
    np.testing.assert_allclose(stamps[-100:], truth[-100:], rtol=0.0, atol=2e-5)


@pytest.mark.parametrize('step', [-3600.0, -1e9, 60.0, 3600.0])
def test_a_step_of_the_system_clock_is_followed_after_a_second(step):
    clock = SampleClock(RATE)
    for k in range(1, 600):
        sample = k * BLOCK
        clock.observe(sample, 1.7e9 + sample / RATE + (step if k >= 300 else 0.0))
        assert clock.doubtful == (300 <= k < 330)
    assert clock.restarts == 1
    assert clock.time_of(sample) == pytest.approx(1.7e9 + sample / RATE + step, abs=1e-5)


def test_a_first_block_that_came_late_is_forgotten():
    clock = SampleClock(RATE)
    for k in range(1, 50):
        clock.observe(k * BLOCK, 1.7e9 + k * BLOCK / RATE + (0.2 if k == 1 else 0.0))
    assert clock.time_of(50 * BLOCK) == pytest.approx(1.7e9 + 50 * BLOCK / RATE, abs=1e-5)


def test_late_blocks_do_not_move_the_clock():
    clock = SampleClock(RATE)
    for k in range(1, 600):
        sample = k * BLOCK
        clock.observe(sample, 1.7e9 + sample / RATE + (0.4 if 300 <= k < 312 else 0.0))
        assert clock.time_of(sample) == pytest.approx(1.7e9 + sample / RATE, abs=1e-5)


@pytest.mark.parametrize('error', [-3600.0, -1.0, -0.1, 0.1, 1.0, 1e300, float('nan')])
def test_single_blocks_with_wrong_arrivals_are_refused(error):
    clock, refused = SampleClock(RATE), 0
    for k in range(1, 900):
        sample, wrong = k * BLOCK, k > 60 and k % 7 == 0
        refused += wrong
        clock.observe(sample, 1.7e9 + sample / RATE + (error if wrong else 0.0))
        assert clock.time_of(sample) == pytest.approx(1.7e9 + sample / RATE, abs=1e-5)
    assert (clock.refused, clock.restarts) == (refused, 0)


@pytest.mark.parametrize('rate', [0.98, 0.995, 1.0005, 1.02])
def test_a_wrong_rate_is_found(rate):
    clock, rng = SampleClock(RATE), np.random.default_rng(3)
    for k in range(1, 1800):
        time = 1.7e9 + k * BLOCK / RATE * rate
        clock.observe(k * BLOCK, time + rng.exponential(0.002))
        assert clock.time_of(k * BLOCK) == pytest.approx(time, abs=0.02)
    assert clock.restarts == 0 and clock.ppm == pytest.approx(1e6 * (rate - 1.0), abs=20.0)


@pytest.mark.parametrize('sample', [float('nan'), float('inf'), 1e300, -1.0])
def test_impossible_sample_numbers_are_refused(sample):
    clock = SampleClock(RATE)
    clock.observe(sample, 1.7e9)
    run(clock, 5.0, 0.0, 0.0)
    clock.observe(sample, 1.7e9 + 5.0)
    assert clock.refused == 2 and clock.time_of(RATE) == pytest.approx(1.7e9 + 1.0, abs=1e-5)


def test_nothing_is_known_before_the_first_block():
    with pytest.raises(RuntimeError, match='no block'):
        SampleClock(RATE).time_of(0)


def test_times_are_continuous_when_blocks_arrive_together():
    clock, reader = SampleClock(RATE), BLOCK // 4
    times: list[float] = []
    for k in range(10, 600, 10):    # ten blocks at once, and the first of them 30 ms late
        late = 0.03 if k == 10 else 0.0
        clock.observe(k * BLOCK, 1.7e9 + k * BLOCK / RATE + late)
        times += [clock.time_of(sample) for sample in range((k - 10) * BLOCK, k * BLOCK, reader)]
    steps = np.abs(np.diff(times) - reader / RATE)
    assert steps.max() < FAST_SLEW * reader / RATE + 1e-6
    assert times[-1] == pytest.approx(1.7e9 + (599 - 9) * BLOCK / RATE - reader / RATE, abs=0.005)
