"""The clock of a sender against truth: senders whose offset, drift, jitter, jumps and intruders are known."""

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from av_common.clock import SenderClock

EPOCH = 1.7e9        # s, ROS time of the beginning
MOST_ERROR = 0.02    # s, of every stamp that is dated, beyond the least delay
LEAST_DELAY = 0.001
REDATED = 1.5        # s, after an event


@pytest.fixture
def rng():
    return np.random.default_rng(4)


@dataclasses.dataclass
class Sent:
    """A stamp: its true time, the time of its arrival (s since EPOCH), and whether an intruder sent it."""

    true: float
    stamp: float
    arrival: float
    genuine: bool = True
    dated: float | None = None


def stream(rng, seconds=5.0, rate=100.0, clock=lambda true: 5.0 + true, jitter=0.002, begin=0.0):
    """Stamps of a sender whose time is `clock` of the true time, with an exponential delay."""
    true = begin + np.arange(round(seconds * rate)) / rate
    delays = LEAST_DELAY + rng.exponential(jitter, len(true))
    return [Sent(t, clock(t), t + delay) for t, delay in zip(true, delays, strict=True)]


def date(sent, clock=None):
    """Date all in the order of arrival; returns the clock."""
    clock = clock or SenderClock()
    for one in sorted(sent, key=lambda one: one.arrival):
        dated = clock.date(one.stamp, EPOCH + one.arrival)
        assert dated is None or 0.0 <= dated <= EPOCH + one.arrival    # never in the future
        one.dated = None if dated is None else dated - EPOCH
    return clock


def most_error(sent):
    return max((abs(one.dated - one.true - LEAST_DELAY) for one in sent if one.genuine and one.dated is not None), default=0.0)


def share(sent, begin=0.0, end=math.inf):
    """Share of genuine stamps from `begin` to `end` (s) that were dated."""
    return np.mean([one.dated is not None for one in sent if one.genuine and begin <= one.true < end])


def test_all_stamps_of_a_steady_sender_are_dated(rng):
    sent = stream(rng)
    clock = date(sent)
    assert share(sent) == 1.0 and most_error(sent) < MOST_ERROR
    assert clock.settled and clock.restarts == clock.refused == 0


def test_what_contradicts_the_first_stamps_is_not_dated_before_it_has_agreed_for_a_second(rng):
    sent = [Sent(-0.01, 77.0, -0.01, genuine=False), *stream(rng)]
    clock = date(sent)
    assert share(sent, end=0.95) == 0.0 and share(sent, begin=1.1) == 1.0
    assert clock.restarts == 0 and clock.refused == sum(one.dated is None for one in sent)


def test_the_least_delay_sets_the_offset(rng):
    sent = stream(rng, jitter=0.01)
    assert date(sent).offset - EPOCH == pytest.approx(LEAST_DELAY - 5.0, abs=3e-3)


@pytest.mark.parametrize('drift', [-500e-6, -50e-6, 50e-6, 500e-6])
def test_a_drifting_sender_is_followed(rng, drift):
    sent = stream(rng, seconds=600.0, rate=10.0, clock=lambda true: true * (1 + drift), jitter=0.005)
    clock = date(sent)
    assert most_error(sent) < MOST_ERROR and share(sent, begin=2.0) > 0.99 and clock.restarts == 0


@settings(max_examples=60, deadline=None)
@given(exponent=st.floats(-3.0, 300.0), sign=st.sampled_from([-1.0, 1.0]), drift=st.floats(-500e-6, 500e-6),
       rate=st.sampled_from([100.0, 200.0]), seed=st.integers(0, 2**31))
def test_a_jump_of_the_sender_is_followed_or_not_dated(exponent, sign, drift, rate, seed):
    jump = sign * 10.0**exponent
    sent = stream(np.random.default_rng(seed), seconds=6.0, rate=rate, jitter=0.001,
                  clock=lambda true: 1000.0 + true * (1 + drift) + (jump if true >= 3.0 else 0.0))
    clock = date(sent)
    assert most_error(sent) < MOST_ERROR
    assert share(sent, begin=1.2, end=3.0) > 0.99
    if abs(jump) < 1e8:
        assert share(sent, begin=3.0 + REDATED) > 0.98 and clock.restarts <= 1
    if exponent > 12.0:
        assert share(sent, begin=3.0) == 0.0


@settings(max_examples=30, deadline=None)
@given(stamps=st.lists(st.one_of(st.floats(), st.floats(0.0, 10.0)), max_size=60), arrivals=st.lists(st.floats(), max_size=20),
       seed=st.integers(0, 2**31))
def test_no_number_does_harm(stamps, arrivals, seed):
    """NaN, infinite, huge, denormal and negative stamps and arrivals between those of a stream."""
    rng, clock = np.random.default_rng(seed), SenderClock()
    sent = stream(rng, seconds=3.0, jitter=0.001)
    date(sent + [Sent(true, stamp, true, genuine=False) for stamp in stamps for true in rng.uniform(1.2, 3.0, 1)], clock)
    assert most_error(sent) < MOST_ERROR and share(sent, begin=1.1) > 0.99
    for arrival in arrivals:
        dated = clock.date(1.0, arrival)
        assert dated is None or 0.0 <= dated < 2**31


INTRUDERS = {
    'rising by 0.4 s each': lambda true, number: 0.4 * number,
    'rising by 0.05 s each': lambda true, number: 5.0 + 0.05 * number,
    'early': lambda true, number: 5.3 + true,
    'late': lambda true, number: 4.7 + true,
    'always the same': lambda true, number: 7.0,
    'of another epoch': lambda true, number: 1.7e9 + true,
    'random': lambda true, number: math.fmod(7919.0 * number, 83.0),
}


@pytest.mark.parametrize('rate', [30, 95])
@pytest.mark.parametrize('kind', INTRUDERS)
def test_an_intruder_with_the_senders_address_moves_nothing(rng, kind, rate):
    sent = stream(rng, seconds=8.0)
    times = np.sort(rng.uniform(1.5, 8.0, round(6.5 * rate)))
    sent += [Sent(true, INTRUDERS[kind](true, number), true, genuine=False) for number, true in enumerate(times)]
    clock = date(sent)
    assert most_error(sent) < MOST_ERROR / 2 and share(sent, begin=1.2) > 0.99 and clock.restarts == 0


@pytest.mark.parametrize('rate', [100, 2000])
def test_a_flood_of_rising_stamps_moves_nothing_and_hides_no_restart(rng, rate):
    sent = stream(rng, seconds=8.0, clock=lambda true: true if true < 5.0 else true - 5.0)
    times = np.sort(rng.uniform(1.5, 8.0, 6 * rate))
    sent += [Sent(true, 0.4 * number, true, genuine=False) for number, true in enumerate(times)]
    clock = date(sent)
    assert most_error(sent) < MOST_ERROR and share(sent, begin=1.2, end=5.0) > 0.99
    assert share(sent, begin=5.0 + REDATED) > 0.99 and clock.restarts == 1


def test_a_restarted_sender_is_followed_after_a_second_and_not_by_one_stamp(rng):
    sent = stream(rng, clock=lambda true: 5000.0 + true if true < 3.0 else true - 3.0)
    clock = date(sent)
    assert share(sent, begin=3.0, end=3.9) == 0.0 and share(sent, begin=3.0 + REDATED) == 1.0
    assert most_error(sent) < MOST_ERROR and clock.restarts == 1


@pytest.mark.parametrize('first', [0.0, 1e9, -1e9, 1e300])
def test_a_first_stamp_that_is_wrong_is_forgotten(rng, first):
    sent = [Sent(-0.01, first, -0.01, genuine=False), *stream(rng)]
    clock = date(sent)
    assert share(sent, begin=1.2) == 1.0 and most_error(sent) < MOST_ERROR and clock.restarts == 0


def test_reordered_stamps_are_dated(rng):
    """Neighbours at 100 a second that change places; the intruder is the delay."""
    sent = stream(rng, jitter=0.0005)
    for early, late in zip(sent[::20], sent[1::20], strict=True):
        early.arrival = late.arrival + 0.0005
    clock = date(sent)
    assert share(sent, begin=1.1) == 1.0 and most_error(sent) < MOST_ERROR and clock.restarts == 0


def test_a_pause_changes_nothing(rng):
    sent = [one for one in stream(rng, seconds=15.0) if not 3.0 <= one.true < 13.0]
    clock = date(sent)
    assert share(sent, begin=1.1) == 1.0 and most_error(sent) < MOST_ERROR and clock.restarts == 0


def test_a_burst_after_a_stop_does_not_move_the_clock(rng):
    """What was held back for 10 s comes at once: it is dated truly or not at all, and what follows is dated."""
    sent = stream(rng, seconds=15.0)
    for one in sent:
        if 3.0 <= one.true < 13.0:
            one.arrival = 13.0 + 1e-4 * one.true
    clock = date(sent)
    assert most_error(sent) < MOST_ERROR and clock.restarts == 0
    assert share(sent, begin=1.1, end=3.0) == 1.0 and share(sent, begin=13.1) > 0.99


@pytest.mark.parametrize('length', [0.5, 1.0, 2.0, 5.0])
def test_a_jump_during_a_stop_is_followed_in_spite_of_the_burst(rng, length):
    """What was held back contradicts itself by as much as it is late; that must not hide the stamps that follow."""
    sent = stream(rng, seconds=10.0, rate=200.0, clock=lambda true: 5.0 + true + (0.03 if true >= 3.1 else 0.0), jitter=0.001)
    for one in sent:
        if 3.0 <= one.true < 3.0 + length:
            one.arrival = 3.0 + length + 1e-4 * one.true
    date(sent)
    assert share(sent, begin=3.0 + length + REDATED) > 0.99
    assert most_error([one for one in sent if one.true >= 3.0 + length]) < MOST_ERROR


def test_clocks_that_an_intruder_invents_hide_no_restart(rng):
    """Every 50 ms a burst of stamps for each of 40 clocks, at the sender's address."""
    sent = stream(rng, seconds=8.0, clock=lambda true: 5.0 + true if true < 3.0 else true - 3.0)
    sent += [Sent(true, 100.0 * number + true, true + 1e-4 * number + 0.006 * pair, genuine=False)
             for true in np.arange(1.5, 8.0, 0.4) for number in range(40) for pair in range(2)]
    date(sent)
    assert most_error(sent) < MOST_ERROR and share(sent, begin=1.2, end=3.0) > 0.99
    assert share(sent, begin=3.0 + REDATED) > 0.99


@pytest.mark.parametrize('ahead', [0.02, 0.04, 0.08])
def test_an_intruder_close_to_a_sender_that_restarts_does_not_become_it(rng, ahead):
    """It sends 40 stamps for 100 of the sender, slightly ahead of it, so that they could be of one clock."""
    def clock(true):
        return 5.0 + true if true < 3.0 else true - 3.0

    sent = stream(rng, seconds=8.0, clock=clock)
    sent += [Sent(true, clock(true) + ahead, true + 0.001, genuine=False) for true in np.sort(rng.uniform(1.5, 8.0, 260))]
    date(sent)
    assert most_error(sent) < MOST_ERROR and share(sent, begin=3.0 + REDATED) > 0.95
    assert np.mean([one.dated is None for one in sent if not one.genuine]) > 0.9


@pytest.mark.parametrize('rate', [10, 95])
@pytest.mark.parametrize('kind', ['early', 'of another epoch'])
def test_an_intruder_with_a_clock_of_its_own_does_not_become_a_sender_that_restarts(rng, kind, rate):
    """With its address, and up to 95 stamps for 100 of the sender: they have agreed for long when it restarts."""
    sent = stream(rng, seconds=6.0, clock=lambda true: 1000.0 + true if true < 3.0 else true - 3.0)
    times = np.sort(rng.uniform(1.5, 6.0, round(4.5 * rate)))
    sent += [Sent(true, INTRUDERS[kind](true, number), true, genuine=False) for number, true in enumerate(times)]
    clock = date(sent)
    assert share(sent, begin=3.0 + REDATED) == 1.0 and clock.restarts == 1
    assert all(one.dated is None for one in sent if not one.genuine)


@pytest.mark.parametrize('jump', [-0.03, -0.05, -0.09])
@pytest.mark.parametrize('jitter', [0.002, 0.005, 0.01])
def test_a_small_step_back_is_no_reordering_however_much_delays_vary(rng, jump, jitter):
    """Arrivals are in order, as of one socket, though delays vary by more than the period."""
    sent = stream(rng, seconds=8.0, rate=200.0, jitter=jitter, clock=lambda true: 5.0 + true + (jump if true >= 4.0 else 0.0))
    for one, arrival in zip(sent, np.maximum.accumulate([one.arrival for one in sent]), strict=True):
        one.arrival = arrival
    clock = date(sent)
    assert share(sent, begin=1.2, end=4.0) > 0.99 and share(sent, begin=4.0 + REDATED) > 0.99
    assert most_error([one for one in sent if one.true >= 1.2]) < MOST_ERROR and clock.restarts <= 1


@settings(max_examples=25, deadline=None)
@given(jumps=st.lists(st.tuples(st.floats(1.5, 9.0), st.floats(-1.0, 4.0), st.sampled_from([-1.0, 1.0])), max_size=4),
       drift=st.floats(-500e-6, 500e-6), loss=st.floats(0.0, 0.3), walk=st.one_of(st.none(), st.floats(-2.0, 1.0)),
       seed=st.integers(0, 2**31))
@example(jumps=[(5.2578125, 0.0, 1.0)], drift=0.0, loss=0.0, walk=-2.0, seed=78)    # the intruder completes an agreement
def test_no_history_misdates_a_stamp(jumps, drift, loss, walk, seed):
    """Several jumps of 0.1 to 10,000 s, drift, losses, and an intruder whose clock walks away from the sender's."""
    rng, jumps = np.random.default_rng(seed), sorted(jumps)

    def clock(true):
        return 1000.0 + true * (1.0 + drift) + sum(sign * 10.0**size for begin, size, sign in jumps if true >= begin)

    whole = [sum(sign * 10.0**size for _, size, sign in jumps[:n]) - sum(sign * 10.0**size for _, size, sign in jumps[:m])
             for n in range(len(jumps) + 1) for m in range(n)]
    assume(all(not -1.0 <= change < 0.02 for change in whole))    # a return by less than a second looks like a delay
    sent = [one for one in stream(rng, seconds=11.0, clock=clock, jitter=0.001) if rng.random() >= loss]
    if walk is not None:
        sent += [Sent(one.true, clock(one.true) + 10.0**walk * (one.true - 1.2), one.arrival + rng.exponential(0.001), False)
                 for one in list(sent) if one.true > 1.2 and rng.random() < 0.4]
    date(sent)
    assert most_error([one for one in sent if one.true > 0.1]) < MOST_ERROR


def test_a_sender_whose_clock_stood_still_is_followed(rng):
    sent = [one for one in stream(rng, seconds=18.0, clock=lambda true: true if true < 10.0 else true - 10.0)
            if not 3.0 <= one.true < 13.0]
    clock = date(sent)
    assert most_error(sent) < MOST_ERROR and share(sent, begin=13.0 + REDATED) == 1.0 and clock.restarts == 1


def test_a_stamp_that_is_repeated_does_not_become_new(rng):
    """As of a simulator that is paused, and sends on."""
    sent = stream(rng, seconds=8.0, clock=lambda true: min(true, 3.0))
    date(sent)
    repeated = [one for one in sent if one.true >= 3.0]
    assert max(one.dated for one in repeated if one.dated is not None) < 3.0 + MOST_ERROR
    assert share(sent, begin=3.2) == 0.0


@pytest.mark.parametrize('step', [-1e9, -3600.0, -0.5, 3600.0, 1e8])
def test_after_a_step_of_the_system_clock_stamps_are_of_the_new_time(rng, step):
    clock, dated = SenderClock(), []
    for one in stream(rng, seconds=6.0):
        moved = step if one.true >= 3.0 else 0.0
        time = clock.date(one.stamp, EPOCH + one.arrival + moved)
        dated += [] if time is None else [(one.true, time - EPOCH - moved - one.true)]
    assert max(abs(error) for _, error in dated) < MOST_ERROR
    assert min(true for true, _ in dated if true > 3.0) < 3.0 + REDATED


def test_a_slow_sender_is_late_and_then_followed_by_slewing(rng):
    sent = stream(rng, seconds=10.0, jitter=0.001)
    for one in sent:
        one.arrival += 0.2 if one.true >= 3.0 else 0.0
    clock = SenderClock()
    date([one for one in sent if one.true < 3.0], clock)
    date([one for one in sent if one.true >= 3.0], clock)
    assert clock.restarts == 0 and share(sent, begin=1.1) == 1.0
    assert clock.offset - EPOCH == pytest.approx(0.2 + LEAST_DELAY - 5.0, abs=2e-3)


@pytest.mark.parametrize('drift', [-20e-6, 0.0, 20e-6])
@pytest.mark.parametrize(('late', 'seconds'), [(0.1, 60.0), (0.3, 300.0), (0.9, 600.0)])
def test_a_sender_that_was_late_for_minutes_is_not_early_when_it_is_on_time_again(rng, late, seconds, drift):
    """It catches up within two seconds."""
    sent = stream(rng, seconds=seconds + 40.0, rate=20.0, clock=lambda true: true * (1.0 - drift))
    for one in sent:
        one.arrival += late * min(max(12.0 + seconds - one.true, 0.0) / 2.0, 1.0) if one.true >= 10.0 else 0.0
    clock = date(sent)
    assert share(sent, begin=1.1) == 1.0 and clock.restarts == 0
    assert most_error([one for one in sent if one.true > 20.0 + seconds]) < MOST_ERROR


@pytest.mark.parametrize('rate', [20.0, 100.0, 400.0])
@pytest.mark.parametrize('seed', range(4))
def test_later_stamps_are_never_dated_earlier(rate, seed):
    """In spite of jitter, drift, a late first stamp, lateness that ends at once, and a burst. Arrivals have the last word."""
    rng = np.random.default_rng(seed)
    sent = stream(rng, seconds=16.0, rate=rate, clock=lambda true: true * (1.0 + 500e-6 * (-1.0)**seed), jitter=0.008)
    for one in sent:
        one.arrival += 0.15 * (4.0 <= one.true < 6.0) + 0.03 * (8.0 <= one.true < 9.5)
        if one is sent[0] or 12.0 <= one.true < 12.8:
            one.arrival = max(one.arrival, 0.2 if one is sent[0] else 12.8 + 1e-3 * (one.true - 12.0))
    for one, other in pairwise(sent):
        other.arrival = max(one.arrival, other.arrival)    # over one socket
    date(sent)
    found = [one for one in sent if one.dated is not None]
    steps = np.diff([one.dated for one in found])
    assert len(found) > 0.97 * len(sent) and steps.min() >= 0.0
    assert all(step > 0.4 / rate or one.arrival - one.dated < 1e-6
               for step, one in zip(steps, found[1:], strict=True) if one.true > 1.5)


@pytest.mark.parametrize('rate', [2.0, 5.0, 30.0, 1000.0])
def test_streams_of_any_rate_are_dated(rng, rate):
    sent = stream(rng, seconds=8.0, rate=rate, jitter=0.001)
    date(sent)
    assert share(sent, begin=1.8) == 1.0 and most_error(sent) < MOST_ERROR


def test_counts_of_our_own_are_dated_from_the_first_on(rng):
    clock = SenderClock()
    dated = [clock.date(n / 30, EPOCH + n / 30 + LEAST_DELAY + (0.3 if n == 0 else rng.exponential(0.005))) for n in range(300)]
    error = np.array(dated) - EPOCH - np.arange(300) / 30 - LEAST_DELAY
    assert error[0] == pytest.approx(0.3, abs=1e-6) and np.abs(error[10:]).max() < 5e-3


def test_what_a_stamp_cannot_hold_is_not_dated():
    clock = SenderClock()
    assert clock.date(0.0, 2.0**31) is None and clock.date(0.0, -1.0) is None
    assert clock.date(0.0, 2.0**31 - 1.0) == 2.0**31 - 1.0
