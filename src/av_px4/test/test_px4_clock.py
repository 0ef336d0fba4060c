"""Odometry while PX4's clock is unsynchronised, synchronised, reset, slewed and drifting: dated truly or not at all."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from av_common.freshness import Instant
from av_common.parameters import node_parameters
from av_common.stamps import to_seconds
from av_px4.stage import ODOMETRY_TOPIC, Px4Stage

EPOCH = 1.7e9     # s, ROS time
RATE = 100.0
BOOTED = 900.0    # s before the beginning


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def unsynchronised(time):
    return BOOTED + time


def synchronised(time):
    return EPOCH + time - 0.187


def pieces(*parts):
    """PX4's clock of (begin, clock) in order."""
    return lambda time: next(clock for begin, clock in reversed(parts) if time >= begin)(time)


CLOCKS = {
    'synchronised late': pieces((0.0, unsynchronised), (10.0, synchronised)),
    'lost for half a second': pieces((0.0, synchronised), (10.0, unsynchronised), (10.5, synchronised)),
    'lost for two seconds': pieces((0.0, synchronised), (10.0, unsynchronised), (12.0, synchronised)),
    'lost for single stamps': lambda time: unsynchronised(time) if round(time * RATE) % 7 == 0 else synchronised(time),
    'lost and regained again and again': lambda time: unsynchronised(time) if 8.0 < time < 20.0 and time % 0.7 < 0.3
    else synchronised(time),
    'a second ahead after a stall': pieces((0.0, synchronised), (10.0, lambda time: synchronised(time) + 1.0),
                                           (13.0, synchronised)),
    'reset with another offset': pieces((0.0, synchronised), (10.0, lambda time: synchronised(time) + 0.15)),
    'ahead for a second': pieces((0.0, synchronised), (10.0, lambda time: synchronised(time) + 0.6), (11.0, synchronised)),
    'converges from behind': lambda time: synchronised(time) - 0.3 * np.exp(-max(time - 5.0, 0.0) / 20.0),
    'converges from ahead': lambda time: synchronised(time) + 0.3 * np.exp(-max(time - 5.0, 0.0) / 20.0),
    'drifts': lambda time: synchronised(time * (1.0 + 5e-4)),
    'rebooted': pieces((0.0, unsynchronised), (10.0, lambda time: time - 10.0)),
    'all after each other': pieces((0.0, unsynchronised), (4.0, synchronised), (8.0, unsynchronised), (8.6, synchronised),
                                   (14.0, lambda time: synchronised(time) + 1.2), (20.0, lambda time: time - 20.0)),
}


def fly(rng, clock, seconds=30.0, late=lambda time: 0.0):
    """(true time, error of the stamp) of the odometry, and the stage; late: further delay (s) of what is sent at a time."""
    stage, found = Px4Stage(node_parameters('av_px4', 'px4_node'), SimpleNamespace()), []
    stage.start(Instant(0.0, EPOCH))
    arrival = 0.0
    for time in np.arange(0.0, seconds, 1.0 / RATE):
        arrival = max(time + 0.002 + rng.exponential(0.001) + late(time), arrival)    # the middleware keeps the order
        stamp = max(round(1e6 * clock(time)), 0)
        message = SimpleNamespace(
            timestamp=stamp, timestamp_sample=stamp, pose_frame=1, velocity_frame=1, reset_counter=0,
            position=[0.0, 0.0, -2.0], q=[1.0, 0.0, 0.0, 0.0], velocity=[0.0] * 3, angular_velocity=[0.0] * 3)
        for topic, odometry in stage.on_vehicle_odometry(message, Instant(arrival, EPOCH + arrival)):
            assert topic == ODOMETRY_TOPIC
            dated = to_seconds(odometry.header.stamp)
            assert dated <= EPOCH + arrival + 1e-6
            found.append((time, dated - EPOCH - time))
    return np.array(found), stage


@pytest.mark.parametrize('name', CLOCKS)
def test_no_pose_has_a_wrong_stamp(rng, name):
    found, stage = fly(rng, CLOCKS[name])
    assert np.abs(found[:, 1]).max() < 0.02 + 0.002
    assert stage.clock.refused + len(found) == 3000


@pytest.mark.parametrize(('name', 'events'), [
    ('synchronised late', [0.0, 10.0]), ('lost for two seconds', [0.0, 10.0, 12.0]), ('rebooted', [0.0, 10.0]),
    ('a second ahead after a stall', [0.0, 10.0, 13.0]), ('converges from ahead', [0.0]), ('converges from behind', [0.0]),
    ('drifts', [0.0])])
def test_poses_come_again_within_a_second_and_a_half(rng, name, events):
    found, _ = fly(rng, CLOCKS[name])
    for begin, end in zip(events, [*events[1:], 30.0], strict=True):
        times = found[(found[:, 0] >= begin + 1.5) & (found[:, 0] < end), 0]
        assert len(times) > 0.99 * RATE * (end - begin - 1.5)


LATE = {'while all starts': lambda time: 0.05 if time < 3.0 else 0.0,
        'while all starts, a lot': lambda time: 0.8 if time < 3.0 else 0.0,
        'for a second and a half': lambda time: 0.03 if 10.0 < time < 11.5 else 0.0,
        'for four seconds': lambda time: 0.2 if 10.0 < time < 14.0 else 0.0,
        'ever more': lambda time: 0.02 * (time - 10.0) if 10.0 < time < 15.0 else 0.0,
        'again and again': lambda time: 0.08 if time % 5.0 < 2.0 else 0.0,
        'in a stall of the agent': lambda time: max(10.8 - time, 0.0) if time > 10.0 else 0.0}


@pytest.mark.parametrize('late', LATE.values(), ids=LATE)
def test_lateness_is_no_restart_of_the_clock(rng, late):
    """Nothing is left out after the first second, and what is on time is dated truly within a second and a half."""
    found, stage = fly(rng, synchronised, late=late)
    assert stage.clock.restarts == 0 and stage.clock.refused < 110
    recent = np.array([max(late(time - back) for back in np.arange(0.0, 1.5, 0.05)) for time in found[:, 0]])
    assert np.abs(found[recent == 0.0, 1]).max() < 0.02


def test_single_stamps_of_another_clock_cost_nothing_but_themselves(rng):
    found, stage = fly(rng, CLOCKS['lost for single stamps'])
    assert stage.clock.restarts == 0
    assert (found[:, 0] > 1.5).sum() == pytest.approx(2850 * 6 / 7, rel=0.01)


@pytest.mark.parametrize('stamp', [0, 1, 2**63, 2**64 - 1, 3_600_000_000 * 10**6])
def test_a_clock_that_stands_still_dates_nothing_for_long(rng, stamp):
    found, stage = fly(rng, lambda time: 1e-6 * stamp)
    assert len(found) < 15 and stage.clock.refused == 3000 - len(found)
    assert all(abs(error) < 0.11 for _, error in found)
