"""The pointing controller reaches its target and never exceeds a limit, for any input."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from av_common.angles import wrap
from av_common.limited_axis import AxisLimits, LimitedAxis
from av_common.track import State, Track
from av_pointing.controller import PERIOD_S, Ages, Mode, PointingController, PointingSettings

WILD = st.one_of(st.floats(-10.0, 10.0), st.sampled_from([math.nan, math.inf, -math.inf, math.pi, -math.pi, 0.0, 3e38]))
AGES = st.one_of(st.floats(0.0, 3.0), st.sampled_from([0.0, 0.3, math.inf]))
STEPS = st.lists(st.tuples(st.floats(-0.5, 0.5), st.sampled_from(list(State)), WILD, WILD, WILD, st.booleans(), WILD,
                           st.booleans(), st.tuples(AGES, AGES, AGES)), min_size=1, max_size=40)
BODY = PointingSettings(move_gimbal=False)
FRESH = Ages(0.0, 0.0, 0.0)


@settings(max_examples=300, deadline=None)
@given(STEPS)
def test_no_command_breaks_a_limit(steps):
    """Angle, rate and acceleration hold over any sequence, NaN, jumps of time and switches included.

    The acceleration of the body, too, while the ages grow no faster than time passes; else to stand still counts for more.
    """
    controller, time, before = PointingController(), 50.0, None
    limits = controller.settings
    left = math.inf
    for dt, state, azimuth, rate, elevation, resolved, rotation, enabled, ages in steps:
        time += dt
        controller.enabled = enabled
        ages = Ages(*ages)
        command = controller.step(time, Track(time, state, azimuth=azimuth, azimuth_world_rate=rate,
                                              elevation=elevation, elevation_variance=0.1, resolved=resolved,
                                              requested_rotation=rotation), ages)
        sudden, left = ages.body_left < left - max(dt, 0.0), ages.body_left
        assert command.yaw_rate == 0.0 or ages.body_left > PERIOD_S
        axes = ((command.pan, command.pan_rate, limits.pan), (command.tilt, command.tilt_rate, limits.tilt),
                (0.0, command.yaw_rate, limits.yaw))
        for angle, velocity, limit in axes:
            assert math.isfinite(angle) and limit.lower - 1e-9 <= angle <= limit.upper + 1e-9
            assert math.isfinite(velocity) and abs(velocity) <= limit.rate + 1e-9
        if before is not None:
            for (_, now, limit), (_, then, _) in zip(axes[:2] if sudden else axes, before, strict=False):
                assert abs(now - then) <= limit.acceleration * max(dt, 0.0) + 1e-9
        before = axes


@given(st.floats(-3.0, 3.0), st.floats(0.2, 4.0), st.floats(0.5, 20.0))
@settings(max_examples=100, deadline=None)
def test_an_axis_arrives_without_overshoot(target, rate, acceleration):
    """At rest, within the time that a trapezoidal profile with a third of the acceleration needs."""
    axis = LimitedAxis(AxisLimits(rate, acceleration))
    needed = abs(target) / rate + 2.0 * math.sqrt(abs(target) / (acceleration / 3.0)) + 2.0
    for _ in range(int(needed / 0.02)):
        axis.follow(target - axis.position, 0.0, 0.02)
        assert abs(axis.position) <= abs(target) + 0.02 * abs(axis.velocity) + 1e-6
    assert axis.position == pytest.approx(target, abs=0.02)


def simulate(controller: PointingController, azimuth_world, seconds: float, **fields):
    """Body yaw (rad) that obeys the commands; yields (time, yaw, command)."""
    yaw, dt = 0.0, 0.02
    for step in range(int(seconds / dt)):
        time = step * dt
        rate = (azimuth_world(time + dt) - azimuth_world(time)) / dt
        track = Track(time, State.ACOUSTIC_ACTIVE, azimuth=float(wrap(azimuth_world(time) - yaw)), azimuth_world_rate=rate,
                      resolved=True)
        command = controller.step(time, track._replace(**fields), FRESH)
        yaw += command.yaw_rate * dt
        yield time, yaw, command


@pytest.mark.parametrize('start_deg', [30, 150, -179, -100])
def test_the_body_turns_to_the_target_the_short_way_and_follows(start_deg):
    """A target at 20 deg/s is followed within 2 deg; the first turn is towards the nearer side."""
    path = lambda t: math.radians(start_deg + 20.0 * t)  # noqa: E731
    run = list(simulate(PointingController(BODY), path, 12.0))
    assert np.sign(run[10][1]) == np.sign(start_deg)
    errors = [abs(float(wrap(path(time) - yaw))) for time, yaw, _ in run if time > 9.0]
    assert math.degrees(max(errors)) < 2.0


@pytest.mark.parametrize('obeys', [0.0, 0.5, 1.0])
def test_the_gimbal_follows_however_the_body_obeys(obeys):
    """A vehicle whose pilot has not handed over stands still while the body is commanded: the gimbal does not count on it."""
    controller, yaw, errors = PointingController(), 0.0, []
    for step in range(400):
        time, target = 0.02 * step, math.radians(-60.0 + 20.0 * 0.02 * step)
        command = controller.step(time, Track(time, State.VISUAL_ACTIVE, azimuth=float(wrap(target - yaw)),
                                              azimuth_world=target, azimuth_world_rate=math.radians(20.0)), FRESH)
        errors.append(abs(float(wrap(target - yaw - command.pan))))
        yaw += obeys * command.yaw_rate * 0.02
    assert math.degrees(max(errors[200:])) < 2.0


@pytest.mark.parametrize('lost', ['bearing', 'measurement', 'odometry'])
def test_the_body_stands_still_0_3_s_after_the_last_input(lost):
    """Whichever input ends, within the limit of acceleration, and 0 is commanded one period before."""
    controller, limits = PointingController(BODY), BODY.yaw
    before = list(simulate(controller, lambda t: 3.0, 1.0))[-1][2].yaw_rate
    assert before > 0.5
    for k in range(1, 40):
        track = Track(0.98 + 0.02 * k, State.ACOUSTIC_ACTIVE, azimuth=1.0, resolved=True)
        command = controller.step(0.98 + 0.02 * k, track, FRESH._replace(**{lost: 0.02 * k}))
        assert abs(command.yaw_rate - before) <= 0.02 * limits.acceleration + 1e-9
        assert command.yaw_rate == 0.0 or lost == 'bearing' or 0.02 * k < 0.3 - PERIOD_S
        before = command.yaw_rate
    assert before == 0.0 and command.mode == Mode.HOLD


def test_the_gimbal_follows_a_prediction_ever_slower_to_its_limit():
    """Of time or of sigma; then it holds, and the reason says so. The body has stood still since 0.3 s."""
    for sigma_deg, limit in ((5.0, 2.0), (25.0, 0.3)):
        controller, rates = PointingController(), []
        for k in range(150):
            track = Track(0.02 * k, State.COASTING, azimuth=2.5 * math.sin(0.02 * k), resolved=True,
                          azimuth_variance=math.radians(sigma_deg) ** 2)
            command = controller.step(0.02 * k, track, Ages(0.0, 0.02 * k + 0.01, 0.0))
            rates.append(abs(command.pan_rate))
            slowest = controller.settings.pan.rate * max(1.0 - 0.01 * k, 0.0)
            assert rates[-1] <= slowest + controller.settings.pan.acceleration * 0.02 or sigma_deg > 20.0
            assert command.yaw_rate == 0.0 or 0.02 * k < 0.3
            assert command.mode == (Mode.TRACK if 0.02 * k + 0.01 < limit else Mode.HOLD)
            assert 0.02 * k < 0.3 or 'prediction' in command.reason
        assert rates[40] > 0.1 or sigma_deg > 20.0
        assert max(rates[round(limit / 0.02) + 20:]) == 0.0


def test_searches_only_while_front_and_back_are_open():
    """A requested rotation turns the body; once resolved the bearing is followed; without either the rig listens."""
    controller = PointingController(BODY)
    open_question = Track(0.0, State.ACOUSTIC_ACTIVE, azimuth=2.0, requested_rotation=-0.8)
    controller.step(0.0, open_question, FRESH)
    command = controller.step(0.1, open_question._replace(time=0.1), FRESH)
    assert command.mode == Mode.SEARCH and command.yaw_rate < 0.0
    assert controller.step(0.2, open_question._replace(time=0.2, requested_rotation=0.0), FRESH).mode == Mode.HOLD
    assert controller.step(0.3, open_question._replace(time=0.3, resolved=True), FRESH).mode == Mode.TRACK
    for lost in ('measurement', 'odometry'):
        command = controller.step(0.4, open_question._replace(time=0.4), FRESH._replace(**{lost: 0.3}))
        assert command.mode == Mode.HOLD and command.yaw_rate == 0.0 and lost in command.reason


def test_neutral_on_stale_brings_the_gimbal_back():
    """`on_stale` neutral returns pan and tilt to 0, in no mode in which nothing moves."""
    controller = PointingController(PointingSettings(neutral=True, move_body=False))
    track = Track(0.0, State.VISUAL_ACTIVE, azimuth=1.0, elevation=0.4, elevation_variance=0.01)
    for k in range(100):
        command = controller.step(0.02 * k, track._replace(time=0.02 * k), FRESH)
    assert command.pan == pytest.approx(1.0, abs=0.02) and command.tilt == pytest.approx(0.4, abs=0.02)
    for k in range(200):
        command = controller.step(2.0 + 0.02 * k, track, Ages(0.02 * k, 0.02 * k, 0.0))
    assert abs(command.pan) < 0.02 and abs(command.tilt) < 0.02 and (command.mode, command.yaw_rate) == (Mode.LOOK, 0.0)
    controller.enabled = False
    assert controller.step(7.0, track, Ages()).mode == Mode.HOLD


@pytest.mark.parametrize('change', [{'rate': 0.0}, {'acceleration': -1.0}, {'lower': 0.1}, {'upper': -0.1}])
def test_impossible_limits_are_refused(change):
    """Limits that hold no motion or exclude neutral are named."""
    with pytest.raises(ValueError, match='axis limits'):
        AxisLimits(**{'rate': 1.0, 'acceleration': 1.0, **change})


def test_other_limits_of_rate_hold_from_the_next_commands_on_and_never_above_the_vehicles():
    """Slower than the vehicle's own limit, then faster than it: the smaller of both holds, and words say so."""
    controller = PointingController()
    controller.limit_body(math.radians(30.0))
    step, fastest = 0, {}
    for yaw_deg, gimbal_deg in ((45.0, 120.0), (10.0, 20.0), (90.0, 200.0)):
        axes = {name: replace(getattr(controller.settings, name), rate=math.radians(rate))
                for name, rate in (('pan', gimbal_deg), ('tilt', gimbal_deg), ('yaw', yaw_deg))}
        controller.limit_rates(replace(PointingSettings(), **axes))
        commands = []
        for _ in range(60):
            step += 1
            time = 50.0 + step * PERIOD_S
            azimuth = 2.0 * (-1.0) ** (step // 60)
            commands.append(controller.step(time, Track(time, State.VISUAL_ACTIVE, azimuth=azimuth, resolved=True), FRESH))
        fastest[yaw_deg] = [max(abs(math.degrees(getattr(one, rate))) for one in commands[20:])
                            for rate in ('yaw_rate', 'pan_rate')]
    assert fastest[45.0][0] <= 30.0 + 1e-9 and fastest[90.0][0] <= 30.0 + 1e-9
    assert fastest[10.0][0] == pytest.approx(10.0, abs=0.1) and fastest[10.0][1] <= 20.0 + 1e-9
    assert controller.may_move == 'the gimbal (up to 200 deg/s) and the body of the rig (up to 30 deg/s)'


@pytest.mark.parametrize(('gimbal', 'body', 'words'), [
    (True, False, 'the gimbal (up to 120 deg/s)'), (False, False, 'nothing')])
def test_what_may_move_is_what_is_configured_whatever_was_commanded(gimbal, body, words):
    controller = PointingController(PointingSettings(
        move_gimbal=gimbal, move_body=body, pan=AxisLimits(math.radians(120.0), 6.0), tilt=AxisLimits(1.0, 6.0)))
    for enabled in (True, False):
        controller.enabled = enabled
        controller.step(1.0, None, Ages())
        assert controller.may_move == words
