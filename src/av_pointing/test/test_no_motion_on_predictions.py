"""Whatever is published, the body moves by new measurements and odometry only, and every command is within its limits."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nav_msgs.msg import Odometry

from av_common.freshness import Instant
from av_common.parameters import node_parameters
from av_common.stamps import to_stamp
from av_interfaces.msg import Bearing, PointingCommand
from av_pointing.stage import make_pointing_stage

EPOCH = 1.7e9
SLIP = 1e-6  # s, by which the node's clock falls behind at each step, so that no two data have one stamp by chance
VALUES = st.one_of(st.floats(-4.0, 4.0, width=32),
                   st.sampled_from([math.nan, math.inf, -math.inf, 3e38, -3e38, 0.0, math.pi]))
# s, of a stamp before the arrival: usual, late, too late, from the future, never
LAGS = st.one_of(st.floats(0.0, 0.4), st.sampled_from([0.0, 0.05, 0.2, 0.9, 0.99, 1.5, -0.05, -0.2, -1.0, -5.0, -1e8, EPOCH]))
BEARINGS = st.tuples(st.just('bearing'), st.sampled_from(['new', 'new', 'new', 'again', 'restamped']), LAGS, LAGS, VALUES,
                     VALUES, VALUES, st.booleans(), st.integers(0, 255))
EVENTS = st.one_of(
    BEARINGS, BEARINGS,
    st.tuples(st.just('measurement')),
    st.tuples(st.just('odometry'), LAGS, st.sampled_from([1.0, 1.0, 1.0, 0.0, math.nan])),
    st.tuples(st.just('time')), st.tuples(st.just('enable'), st.booleans()),
    st.tuples(st.just('step of the clock'), st.sampled_from([-3600.0, -2.0, -0.5, 0.5, 2.0, 3600.0])))
# time step, whether odometry arrives, what else happens, and how often in succession
STEPS = st.lists(st.tuples(st.sampled_from([0.0, 0.01, 0.02, 0.033, 0.033, 0.05, 0.25, 1.2]),
                           st.sampled_from([True, True, False]), EVENTS, st.sampled_from([1, 1, 5, 20])), max_size=20)
RUN_UP = [(0.033, True, ('measurement',), 15)]  # the body turns, or the gimbal moves


def make_stage(**values):
    return make_pointing_stage(node_parameters('av_pointing', 'pointing_node', overrides={'enabled': True, **values}))


def pose(ros, w=1.0):
    message = Odometry()
    message.header.stamp, message.pose.pose.orientation.w = to_stamp(ros), w
    return message


def bearing(ros, measured, azimuth=1.0, rotation=0.0, resolved=True, **fields):
    return Bearing(state=Bearing.STATE_ACOUSTIC_ACTIVE, azimuth=azimuth, azimuth_variance=0.01, azimuth_world=azimuth,
                   resolved=resolved, requested_rotation=rotation, measured=to_stamp(measured),
                   header=Bearing().header.__class__(stamp=to_stamp(ros)), **fields)


class Witness:
    """Knows independently of the stage when data first arrived, and how old it was."""

    def __init__(self):
        self.first = {}

    def note(self, stamp, now):
        self.first.setdefault(stamp, (now.steady, now.ros - stamp))

    def permits(self, now, timeout, oldest):
        return any(now.steady - arrived < timeout and now.steady - arrived + age < oldest + 500 * SLIP and age >= -0.1
                   for arrived, age in self.first.values())


def checked(command, limits, before, dt):
    """The rates of a command, after all limits are checked; `before` are those of the one `dt` s earlier."""
    rates = (command.pan_rate, command.tilt_rate, command.yaw_rate)
    axes = zip((command.pan, command.tilt, 0.0), rates, before or rates, (limits.pan, limits.tilt, limits.yaw), strict=True)
    for angle, rate, previous, limit in axes:
        assert math.isfinite(angle) and limit.lower - 1e-6 <= angle <= limit.upper + 1e-6
        assert math.isfinite(rate) and abs(rate) <= limit.rate + 1e-6
        assert abs(rate - previous) <= limit.acceleration * dt + 1e-6
    return rates


@settings(max_examples=150, deadline=None)
@given(STEPS, st.booleans())
def test_no_sequence_of_messages_moves_what_must_stand(steps, move_gimbal):
    """Moving, repeated, restamped, future and old stamps, absurd values, gaps of odometry, steps of the clock."""
    stage = make_stage(move_gimbal=move_gimbal)
    limits = stage.controller.settings
    measured, odometry, last, before, steady, offset = Witness(), Witness(), None, None, 50.0, EPOCH
    sequence = [step[:3] for step in RUN_UP + steps for _ in range(step[3])]
    for dt, posed, (kind, *content) in sequence:
        steady += dt
        offset -= SLIP
        if kind == 'step of the clock':
            offset += content[0]
        now = Instant(steady, steady + offset)
        if kind == 'odometry' or posed:
            lag, w = content if kind == 'odometry' else (0.0, 1.0)
            stamp = pose(max(now.ros - lag, 0.0), w)
            odometry.note(stamp.header.stamp.sec + 1e-9 * stamp.header.stamp.nanosec, now)
            stage.on_odometry(stamp, now)
        if kind == 'measurement':
            last = bearing(now.ros, now.ros - 0.1, 2.5)
            measured.note(last.measured.sec + 1e-9 * last.measured.nanosec, now)
            command = stage.on_bearing(last, now)
        elif kind == 'bearing':
            how, age, lag, azimuth, rate, rotation, resolved, state = content
            if last is None or how == 'new':
                last = bearing(max(now.ros - age, 0.0), max(now.ros - lag, 0.0), azimuth, rotation, resolved,
                               azimuth_world_rate=rate, elevation=azimuth, elevation_variance=0.1)
                last.state = state % 8
            elif how == 'restamped':
                last.header.stamp = to_stamp(now.ros)
            measured.note(last.measured.sec + 1e-9 * last.measured.nanosec, now)
            command = stage.on_bearing(last, now)
        elif kind == 'enable':
            stage.controller.enabled, = content
            command = stage.on_time(now)
        else:
            command = stage.on_time(now)
        assert command.move_body == stage.controller.enabled and command.move_gimbal == (command.move_body and move_gimbal)
        if command.yaw_rate != 0.0:
            assert measured.permits(now, 0.3, 1.0) and odometry.permits(now, 0.3, 0.3)
        assert command.mode in (PointingCommand.MODE_HOLD, PointingCommand.MODE_TRACK, PointingCommand.MODE_SEARCH)
        before = checked(command, limits, before, dt)


@pytest.mark.parametrize('measured', [lambda t: 0.0, lambda t: t + 0.5, lambda t: -t, lambda t: 2.0, lambda t: 1e8,
                                      lambda t: -EPOCH, lambda t: 0.2 * math.sin(40.0 * t) - 0.2])
@pytest.mark.parametrize('rotation', [0.0, 0.8])
def test_predictions_end_the_turn_in_time(measured, rotation):
    """Bearings go on with moving stamps, `measured` stands still, is of the future or goes back: 0 within 0.3 s."""
    stage, before, turned = make_stage(), 0.0, 0.0
    for k in range(150):
        now = Instant(10.0 + 0.02 * k, EPOCH + 0.02 * k)
        t = 0.02 * (k - 50)  # since the newest measurement
        stage.on_odometry(pose(now.ros), now)
        message = bearing(now.ros, now.ros if t <= 0.0 else EPOCH + 1.0 + measured(t), 2.0, rotation, rotation == 0.0)
        command = stage.on_bearing(message, now)
        assert abs(command.yaw_rate - before) <= stage.controller.settings.yaw.acceleration * 0.02 + 1e-6
        assert t < 0.3 - 1.0 / 30.0 or command.yaw_rate == 0.0
        before, turned = command.yaw_rate, max(turned, abs(command.yaw_rate))
    assert turned > 0.5 and ('prediction' in command.reason or 'stands still' in command.reason)


def test_old_measurements_and_old_odometry_turn_nothing():
    """Measurements that arrive 1 s after their capture, and poses that arrive after 0.3 s, although both advance."""
    for lag, delay in ((1.0, 0.0), (0.1, 0.3)):
        stage = make_stage()
        for k in range(100):
            now = Instant(10.0 + 0.02 * k, EPOCH + 0.02 * k)
            stage.on_odometry(pose(now.ros - delay), now)
            assert stage.on_bearing(bearing(now.ros, now.ros - lag), now).yaw_rate == 0.0


def test_it_moves_again_when_measurements_return():
    """After a gap the first new measurement counts, after a wrong clock the body waits for 1.1 s."""
    for spoiled, longest in ((False, 0.1), (True, 1.3)):
        stage, began = make_stage(), None
        for k in range(200):
            now = Instant(10.0 + 0.02 * k, EPOCH + 0.02 * k)
            stage.on_odometry(pose(now.ros), now)
            if k == 100 and spoiled:
                stage.on_bearing(bearing(now.ros, now.ros + 1e8), now)
            if k < 50 or k > 100:
                command = stage.on_bearing(bearing(now.ros, now.ros - 0.1), now)
                if k > 100 and command.yaw_rate != 0.0:
                    began = began or 0.02 * (k - 100)
        assert began is not None and began <= longest
