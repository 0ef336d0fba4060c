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
from av_pointing.controller import Mode, PointingController, PointingSettings

WILD = st.one_of(st.floats(-10.0, 10.0), st.sampled_from([math.nan, math.inf, -math.inf, math.pi, -math.pi, 0.0]))
STEPS = st.lists(st.tuples(st.floats(-0.5, 0.5), st.sampled_from(list(State)), WILD, WILD, WILD, st.booleans(), WILD,
                           st.floats(-1.0, 1.0), st.booleans()), min_size=1, max_size=40)
BODY = PointingSettings(move_gimbal=False)


@settings(max_examples=300, deadline=None)
@given(STEPS)
def test_no_command_breaks_a_limit(steps):
    """Angle, rate and acceleration hold over any sequence, NaN, jumps of time and switches included."""
    controller, time, before = PointingController(), 50.0, None
    limits = controller.settings
    for dt, state, azimuth, rate, elevation, resolved, rotation, age, enabled in steps:
        time += dt
        controller.enabled = enabled
        command = controller.step(time, Track(time - age, state, azimuth=azimuth, azimuth_world_rate=rate,
                                              elevation=elevation, elevation_variance=0.1, resolved=resolved,
                                              requested_rotation=rotation))
        axes = ((command.pan, command.pan_rate, limits.pan), (command.tilt, command.tilt_rate, limits.tilt),
                (0.0, command.yaw_rate, limits.yaw))
        for angle, velocity, limit in axes:
            assert math.isfinite(angle) and limit.lower - 1e-9 <= angle <= limit.upper + 1e-9
            assert math.isfinite(velocity) and abs(velocity) <= limit.rate + 1e-9
        if before is not None:
            elapsed = min(max(dt, 0.0), 0.1)
            for (_, now, limit), (_, then, _) in zip(axes, before, strict=True):
                assert abs(now - then) <= limit.acceleration * elapsed + 1e-9
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
        command = controller.step(time, track._replace(**fields))
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
                                              azimuth_world=target, azimuth_world_rate=math.radians(20.0)))
        errors.append(abs(float(wrap(target - yaw - command.pan))))
        yaw += obeys * command.yaw_rate * 0.02
    assert math.degrees(max(errors[200:])) < 2.0


def test_stale_bearings_stop_all_motion():
    """Within 0.3 s of the last bearing the rig is at rest."""
    controller = PointingController(replace(BODY, stale_after=0.05))
    moving = list(simulate(controller, lambda t: 3.0, 1.0))[-1][2]
    assert moving.yaw_rate > 0.5
    track = Track(0.98, State.ACOUSTIC_ACTIVE, azimuth=1.0, resolved=True)
    late = [controller.step(1.0 + 0.02 * k, track) for k in range(20)]
    assert late[15].yaw_rate == 0.0 and late[-1].mode == Mode.HOLD


def test_searches_only_while_front_and_back_are_open():
    """A requested rotation turns the body; once resolved the bearing is followed; without either the rig listens."""
    controller = PointingController(BODY)
    open_question = Track(0.0, State.ACOUSTIC_ACTIVE, azimuth=2.0, requested_rotation=-0.8)
    controller.step(0.0, open_question)
    command = controller.step(0.1, open_question._replace(time=0.1))
    assert command.mode == Mode.SEARCH and command.yaw_rate < 0.0
    assert controller.step(0.2, open_question._replace(time=0.2, requested_rotation=0.0)).mode == Mode.HOLD
    assert controller.step(0.3, open_question._replace(time=0.3, resolved=True)).mode == Mode.TRACK


def test_neutral_on_stale_brings_the_gimbal_back():
    """`on_stale` neutral returns pan and tilt to 0."""
    controller = PointingController(PointingSettings(on_stale='neutral', move_body=False))
    track = Track(0.0, State.VISUAL_ACTIVE, azimuth=1.0, elevation=0.4, elevation_variance=0.01)
    for k in range(100):
        command = controller.step(0.02 * k, track._replace(time=0.02 * k))
    assert command.pan == pytest.approx(1.0, abs=0.02) and command.tilt == pytest.approx(0.4, abs=0.02)
    for k in range(200):
        command = controller.step(2.0 + 0.02 * k, track)
    assert abs(command.pan) < 0.02 and abs(command.tilt) < 0.02


@pytest.mark.parametrize('change', [{'rate': 0.0}, {'acceleration': -1.0}, {'lower': 0.1}, {'upper': -0.1}])
def test_impossible_limits_are_refused(change):
    """Limits that hold no motion or exclude neutral are named."""
    with pytest.raises(ValueError, match='axis limits'):
        AxisLimits(**{'rate': 1.0, 'acceleration': 1.0, **change})
