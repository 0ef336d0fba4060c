"""The clocks against senders whose offset, drift and jitter are known."""

import numpy as np
import pytest

from av_common.clock import SenderClock


@pytest.fixture
def rng():
    return np.random.default_rng(4)


def test_the_least_delay_sets_the_offset(rng):
    clock = SenderClock()
    for stamp in np.arange(0, 5, 0.01):
        clock.observe(stamp, 1000.0 + stamp + 0.002 + rng.exponential(0.01))
    assert clock.to_ros(3.0) == pytest.approx(1003.002, abs=1e-3)


@pytest.mark.parametrize('drift', [-50e-6, 50e-6])
def test_a_drifting_sender_is_followed_for_an_hour(rng, drift):
    clock = SenderClock()
    for true in np.arange(0, 3600, 0.2):
        clock.observe(true * (1 + drift), 1000.0 + true + 0.001 + rng.exponential(0.005))
    assert clock.to_ros(3600 * (1 + drift)) == pytest.approx(4600.001, abs=2e-3)


def test_streams_of_one_clock_agree_whatever_their_delay(rng):
    clock = SenderClock()
    for stamp in np.arange(0, 5, 0.01):
        clock.observe(stamp, 50.0 + stamp + 0.001)                 # truth: quick
        clock.observe(stamp, 50.0 + stamp + 0.05 + 0.03 * rng.random())   # images: slow
    assert clock.to_ros(2.0) == pytest.approx(52.001, abs=1e-3)


def test_a_restarted_sender_is_noticed():
    clock = SenderClock()
    for stamp in np.arange(0, 5, 0.01):
        clock.observe(stamp, 100 + stamp)
    for stamp in np.arange(0, 2, 0.01):
        clock.observe(stamp, 106 + stamp)
    assert clock.restarts == 1
    assert clock.to_ros(2.0) == pytest.approx(108.0, abs=1e-3)


@pytest.mark.parametrize('error', [-1.5, 1.5, 1e12])
def test_a_single_wrong_stamp_is_refused(error):
    clock = SenderClock()
    for stamp in np.arange(0, 5, 0.01):
        assert clock.observe(stamp, 100 + stamp)
        if int(stamp * 100) % 100 == 50:
            assert not clock.observe(stamp + error, 100 + stamp)
    assert clock.restarts == 0
    assert clock.to_ros(4.0) == pytest.approx(104.0, abs=1e-3)


def test_a_sender_that_falls_behind_is_late(rng):
    clock = SenderClock()
    for stamp in np.arange(0, 6, 0.01):
        clock.observe(stamp, 10.0 + stamp + 0.005 * rng.random() + (0.2 if stamp > 3 else 0.0))
        if stamp == 2.5:
            assert clock.lateness < 1e-3
    assert clock.lateness == pytest.approx(0.2, abs=2e-3)


def test_unstamped_blocks_are_placed_by_the_lower_envelope(rng):
    clock = SenderClock()
    for n in range(1, 300):
        clock.observe(1600 * n / 48_000, 10.0 + n / 30 + 0.001 + rng.exponential(0.008))
    assert clock.to_ros(1.0) == pytest.approx(11.001, abs=1e-3)


def test_a_sender_without_stamps_has_no_time():
    with pytest.raises(RuntimeError, match='no stamp of the sender'):
        SenderClock().to_ros(1.0)


def test_a_device_clock_that_drifts_is_followed():
    rng = np.random.default_rng(0)
    dated, clock = [], SenderClock()
    true = np.arange(0.0, 60.0, 1 / 30)
    for moment in true:
        stamp = 500.0 + moment * (1 + 3e-5)
        dated.append(clock.date(stamp, moment + 0.004 + rng.exponential(0.01)))
    error = np.array(dated) - true
    assert np.abs(error[60:] - 0.004).max() < 0.004
    assert clock.date(7.0, 100.0) == 100.0  # the device was started again


def test_what_is_refused_is_not_dated():
    clock = SenderClock()
    assert clock.date(0.0, 100.0) == 100.0
    assert clock.date(5.0, 100.1) is None    # from the future
    assert clock.date(-0.7, 100.1) is None   # too late to set the clock by ...
    assert clock.date_late(-0.7, 100.1, latest=10.0) == pytest.approx(99.3)   # ... but a time all the same
    assert clock.date_late(5.0, 100.1, latest=10.0) is None and clock.date_late(-20.0, 100.1, latest=10.0) is None
    assert clock.to_ros(0.0) == 100.0
