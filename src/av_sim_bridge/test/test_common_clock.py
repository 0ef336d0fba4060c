"""The common clock of a simulator's streams, with delays of their own and intruders among them."""

import numpy as np
import pytest

from av_sim_bridge.receiving.common_clock import CommonClock
from av_sim_bridge.wire import ForeignSenderError, UndatedError, WireError

EPOCH, GENUINE, INTRUDER = 1.7e9, ('10.0.0.1', 5000), ('10.0.0.2', 6000)
STREAMS = {'rig_truth': (0.001, 100.0), 'target_truth': (0.001, 100.0), 'audio': (0.005, 30.0), 'imu': (0.001, 200.0),
           'image': (0.08, 15.0)}    # least delay (s) and rate (1/s)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def sent(rng, seconds=6.0, clock=lambda true: true, begin=0.0, streams=tuple(STREAMS), sender=GENUINE):
    """(arrival, stream, sender, stamp, true time) of the simulator's stamps."""
    return [(true + STREAMS[name][0] + rng.exponential(0.001), name, sender, clock(true), true)
            for name in streams for true in begin + np.arange(round(seconds * STREAMS[name][1])) / STREAMS[name][1]]


def date(events, clock=None):
    """Errors (s) of the genuine stamps by stream and true time, NaN for those that were not dated, and the clock."""
    clock, errors = clock or CommonClock(), {name: [] for name in STREAMS}
    for arrival, name, sender, stamp, true in sorted(events):
        try:
            time = clock.date(name, sender, stamp, EPOCH + arrival)
            assert 0.0 <= time <= EPOCH + arrival
        except WireError:
            time = np.nan
        if sender == GENUINE and true is not None:
            errors[name].append((true, time - EPOCH - true))
    return {name: np.array(found) for name, found in errors.items() if found}, clock


def check(errors, begin=1.4, least=0.99, most=0.02):
    for name, found in errors.items():
        dated = np.isfinite(found[:, 1])
        assert np.nanmax(np.abs(found[:, 1])) < most, name
        assert dated[found[:, 0] >= begin].mean() > least, name


def rising(rng, name, sender, count=869, begin=1.5, end=6.0):
    return [(arrival, name, sender, 0.4 * number, None)
            for number, arrival in enumerate(np.sort(rng.uniform(begin, end, count)))]


def test_streams_agree_whatever_their_delay(rng):
    """Images come 80 ms later than truth; a capture has one time."""
    errors, clock = date(sent(rng))
    check(errors, most=0.01)
    assert clock.restarts == 0


@pytest.mark.parametrize('speed', [0.95, 0.8, 0.6])
def test_a_simulator_that_is_slower_than_time_from_the_first_stamp_on_is_dated(rng, speed):
    """All streams alike, late by what the simulator loses in a second."""
    errors, clock = date(sent(rng, clock=lambda true: speed * true))
    check(errors, least=0.98, most=1.2 * (1.0 - speed))
    assert clock.restarts == 0


@pytest.mark.parametrize('seed', range(3))
def test_later_stamps_of_a_stream_are_never_dated_earlier(seed):
    """A simulator that runs at 0.9 times the speed, with jitter, is 0.12 s late for two seconds, which end in a burst."""
    events = []
    newest = dict.fromkeys(STREAMS, 0.0)    # arrival: a stream comes over one socket
    for arrival, name, sender, stamp, true in sent(np.random.default_rng(seed), seconds=10.0, clock=lambda true: 0.9 * true):
        late = 0.12 * (3.0 <= true < 5.0) + max(0.05 * np.sin(40.0 * true + seed), 0.0)
        newest[name] = max(newest[name] + 1e-6, arrival + late)
        events.append((newest[name], name, sender, stamp, true))
    errors, _ = date(events)
    dated = {name: found[:, 0] + found[:, 1] for name, found in errors.items()}
    assert min(np.diff(times[np.isfinite(times)]).min() for times in dated.values()) >= 0.0
    assert all(np.isfinite(times).mean() > 0.8 for times in dated.values())


@pytest.mark.parametrize('sender', [INTRUDER, GENUINE])
@pytest.mark.parametrize('name', STREAMS)
def test_rising_stamps_in_any_stream_move_nothing(rng, name, sender):
    errors, clock = date(sent(rng) + rising(rng, name, sender))
    check(errors)
    assert clock.restarts == 0 and clock.counts[f'{name} undated'] >= 869


@pytest.mark.parametrize('ahead', [-300.0, -0.2, 0.009, 0.03, 0.2, 300.0])
@pytest.mark.parametrize('name', STREAMS)
def test_a_second_sender_that_agrees_with_itself_is_not_obeyed(rng, name, ahead):
    errors, clock = date(sent(rng) + [(*other[:4], None) for other in sent(
        rng, begin=1.5, seconds=4.5, streams=[name], clock=lambda true: true + ahead, sender=INTRUDER)])
    check(errors)
    assert clock.restarts == 0 and clock.counts[f'{name} undated'] > 10
    with pytest.raises(ForeignSenderError, match='10.0.0.2:6000 sends while 10.0.0.1:5000 does'):
        clock.refuse_others(name, INTRUDER, EPOCH + 6.0)


@pytest.mark.parametrize('ahead', [-300.0, 0.2, 300.0])
def test_a_stream_without_a_sender_is_taken_but_moves_no_other(rng, ahead):
    """Nobody sends inertial measurements but the intruder, from before the simulator's start on."""
    genuine = sent(rng, begin=3.0, streams=[name for name in STREAMS if name != 'imu'])
    errors, _ = date(genuine + sent(rng, seconds=9.0, streams=['imu'], clock=lambda true: true + ahead, sender=INTRUDER))
    check({name: found[found[:, 0] > 4.5] for name, found in errors.items()})


@pytest.mark.parametrize('port', [5000, 5001])
@pytest.mark.parametrize('flood', [False, True])
def test_a_restarted_simulator_is_followed(rng, port, flood):
    """Also from another port, and with an intruder that sends 200 stamps a second."""
    clock = CommonClock()
    noise = rising(rng, 'imu', INTRUDER, 1000, 0.5, 6.0) if flood else []
    errors, _ = date(sent(rng, seconds=3.0, clock=lambda true: 1000.0 + true) + [
        (*one[:2], ('10.0.0.1', port), *one[3:]) for one in sent(rng, begin=3.5, seconds=4.0, clock=lambda true: true - 3.5)]
        + noise, clock)
    for name, found in errors.items():
        assert np.nanmax(np.abs(found[:, 1])) < 0.02, name
    assert clock.restarts == 1
    again = clock.date('rig_truth', ('10.0.0.1', port), 4.0, EPOCH + 7.5 + 0.001)
    assert again == pytest.approx(EPOCH + 7.5, abs=0.02)


def test_all_of_one_moment_have_one_time_after_a_restart(rng):
    errors, clock = date(sent(rng, seconds=10.0, clock=lambda true: true if true < 5.0 else true - 5.0))
    check({name: found[found[:, 0] < 5.0] for name, found in errors.items()})
    check({name: found[found[:, 0] >= 5.0] for name, found in errors.items()}, begin=6.5)
    assert clock.restarts == 1


def test_a_stream_of_another_clock_is_refused(rng):
    other = sent(rng, streams=['image'], clock=lambda true: true + 50.0)
    errors, _ = date(sent(rng, streams=[name for name in STREAMS if name != 'image']) + other)
    assert np.isnan(errors.pop('image')[:, 1]).all()
    check(errors)


def test_many_senders_take_no_stream(rng):
    flood = [(arrival, 'rig_truth', ('10.0.0.9', port), float(port), None)
             for port, arrival in enumerate(np.sort(rng.uniform(0.0, 6.0, 5000)))]
    errors, _ = date(sent(rng, begin=0.0) + flood)
    check(errors, begin=2.0)


@pytest.mark.parametrize('stamp', [float('nan'), float('inf'), 1e300, -1e300, 5e-324, -1.0])
def test_hostile_numbers_are_counted(rng, stamp):
    errors, clock = date(sent(rng, seconds=3.0) + [(2.0 + 0.001 * n, 'imu', GENUINE, stamp, None) for n in range(100)])
    check(errors)
    assert clock.counts['imu undated'] >= 100
    with pytest.raises(UndatedError, match='imu: the time 1 s of 10.0.0.1:5000 cannot be dated'):
        clock.date('imu', GENUINE, 1.0, float('nan'))
