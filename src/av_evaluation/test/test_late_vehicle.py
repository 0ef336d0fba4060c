"""Pointing settles with vehicles that answer late, whatever it was told of them, and stops in time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from closed_loop import Conditions, close_loop
from std_msgs.msg import Float32

from av_common.angles import wrap
from av_common.limited_axis import AxisLimits, LimitedAxis
from av_common.parameters import node_parameters
from av_interfaces.msg import PointingCommand
from av_pointing.controller import LEAD_S, PointingController
from av_pointing.response import BodyMotion, Response
from av_pointing.settings import PointingSettings
from av_pointing.stage import PointingStage, make_pointing_stage
from av_px4.guard import BodyGuard, Inputs
from av_px4.handover import EXTERNAL_MODES, VehicleStatus
from av_simulator.motion.axes import YawAxis, YawResponse

NOISE = math.radians(0.5)
FULL = {'noise': NOISE, 'age_jitter': 0.01}
TARGETS = {'at rest': lambda t: math.radians(60.0), 'at 20 deg/s': lambda t: math.radians(20.0 * t - 60.0),
           'weaving': lambda t: math.radians(30.0 * math.sin(0.3 * t) - 40.0)}


def make_stage(**values):
    return make_pointing_stage(node_parameters('av_pointing', 'pointing_node', overrides={
        'enabled': True, 'move_gimbal': False, **values}))


def swing_deg(loop, seconds):
    """Between the largest and the smallest error of the last seconds."""
    return np.degrees(np.ptp(np.array(loop.error)[np.array(loop.time) > loop.time[-1] - seconds]))


@pytest.mark.parametrize('target', TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize('age', [0.05, 0.4, 0.7])
@pytest.mark.parametrize(('dead_time', 'lag'), [(0.1, 0.4), (0.1, 0.8), (0.25, 0.2)])
def test_the_body_settles_at_any_delay_with_any_lag(target, age, dead_time, lag):
    """Below 2 deg rms up to 0.5 s of age and dead time, below 5 at 0.8 s and more; nothing was told of the vehicle."""
    loop = close_loop(make_stage(), Conditions(dead_time, lag, bearing_age=age, **FULL), target, 14.0)
    assert loop.rms_deg(8.0) < (2.0 if age + dead_time <= 0.51 else 5.0)


@pytest.mark.parametrize(('target', 'most'), [
    (TARGETS['weaving'], 0.6), (lambda t: math.atan2(5.0 * (t - 10.0), 10.0), 1.4)], ids=['weaving', 'passing at 10 m'])
def test_a_target_whose_rate_changes_is_followed(target, most):
    """By its acceleration: by its rate alone, errors are 1.2 and 2.1 deg rms."""
    loop = close_loop(make_stage(), Conditions(bearing_age=0.1, **FULL), target, 18.0)
    assert loop.rms_deg(6.0) < most


@pytest.mark.parametrize('lag', [0.2, 0.8])
@pytest.mark.parametrize('told', [0.05, 0.4, 1.0])
def test_no_limit_cycle_with_a_lag_that_it_was_not_told(lag, told):
    stage = PointingStage(PointingController(PointingSettings(move_gimbal=False, response=Response(lag=told))))
    loop = close_loop(stage, Conditions(lag=lag, bearing_age=0.4, **FULL), TARGETS['at rest'], 14.0)
    assert swing_deg(loop, 4.0) < 1.5 and loop.overshoot_deg() < 6.0


CONDITIONS = {
    'ages that vary': Conditions(bearing_age=0.3, age_jitter=0.08, noise=NOISE),
    'a process that stalls': Conditions(bearing_age=0.2, stalls=0.15, noise=NOISE),
    'odometry of 10 Hz, late': Conditions(bearing_age=0.3, odometry_rate=10.0, odometry_age=0.1, noise=NOISE),
    'bearings of 5 Hz': Conditions(bearing_age=0.3, bearing_rate=5.0, noise=NOISE),
    'noise of 2 deg': Conditions(bearing_age=0.3, noise=math.radians(2.0)),
    'less than commanded': Conditions(bearing_age=0.3, gain=0.7, noise=NOISE),
    'more than commanded': Conditions(bearing_age=0.3, gain=1.2, noise=NOISE),
    'slower than the limit of the commands': Conditions(bearing_age=0.3, fastest=math.radians(25.0), noise=NOISE),
    'no direction in the world': Conditions(bearing_age=0.4, world=False, noise=NOISE),
    'stamps that hide the age': Conditions(bearing_age=0.4, world=False, stamped=False, noise=NOISE),
    'answers at once': Conditions(0.0, 0.02, bearing_age=0.1, noise=NOISE),
    'very slow': Conditions(0.4, 1.2, bearing_age=0.2, noise=NOISE)}


@pytest.mark.parametrize('conditions', CONDITIONS.values(), ids=CONDITIONS)
def test_it_settles_in_other_conditions(conditions):
    loop = close_loop(make_stage(), conditions, TARGETS['at 20 deg/s'], 16.0)
    assert loop.rms_deg(9.0) < 2.0 and swing_deg(loop, 4.0) < 6.0


@pytest.mark.parametrize('target', ['at rest', 'at 20 deg/s'])
@pytest.mark.parametrize('drift_deg', [5.0, -10.0])
def test_a_body_that_turns_by_itself_is_held_on_the_target(target, drift_deg):
    """A boat in a current, or in wind: 10 deg/s alone would leave it 8 deg off."""
    loop = close_loop(make_stage(), Conditions(lag=0.8, drift=math.radians(drift_deg), **FULL), TARGETS[target], 20.0)
    assert loop.rms_deg(10.0) < 4.0 and swing_deg(loop, 4.0) < 3.0


@pytest.mark.parametrize('reset_deg', [40.0, -170.0])
@pytest.mark.parametrize('target', ['at rest', 'at 20 deg/s'])
def test_an_estimator_that_corrects_its_heading_teaches_nothing(target, reset_deg):
    """Odometry and directions in the world jump at once, the body does not: what was learned of the vehicle holds."""
    loop = close_loop(make_stage(), Conditions(reset=math.radians(reset_deg), **FULL), TARGETS[target], 16.0)
    assert loop.rms_deg(9.5) < 0.5


class LimitedStage(PointingStage):
    """Its commands reach the vehicle as px4_node lets them through: at most a rate, which it is told."""

    def __init__(self, own_deg, limit_deg):
        limits = AxisLimits(math.radians(own_deg), math.radians(900.0))
        super().__init__(PointingController(PointingSettings(yaw=limits, move_gimbal=False)))
        self._let_through = math.radians(limit_deg)
        self.on_yaw_rate_limit(Float32(data=self._let_through))

    def on_time(self, now):
        command = super().on_time(now)
        command.yaw_rate = min(max(command.yaw_rate, -self._let_through), self._let_through)
        return command


LIMITS = [(45.0, 30.0), (45.0, 20.0), (30.0, 45.0), (90.0, 60.0), (45.0, 15.0), (20.0, 30.0), (30.0, 30.0), (15.0, 100.0)]
FLOWN = {'gain': 0.93, **FULL}    # PX4 in SITL


@pytest.mark.parametrize('age', [0.1, 0.4])
@pytest.mark.parametrize('rate_deg', [15.0, 25.0])
@pytest.mark.parametrize(('own_deg', 'limit_deg'), LIMITS)
def test_no_swing_on_a_moving_target_whatever_the_limits_are(age, rate_deg, own_deg, limit_deg):
    """The target was at rest to the other side. One that is too fast is turned after while it is less than 150 deg off."""
    def target(t):
        return math.radians(-60.0 + rate_deg * max(t - 4.0, 0.0))
    least, seconds = 0.93 * min(own_deg, limit_deg), 26.0
    loop = close_loop(LimitedStage(own_deg, limit_deg), Conditions(bearing_age=age, **FLOWN), target, seconds)
    if least > 1.05 * rate_deg:
        assert swing_deg(loop, 6.0) < 2.0
    else:
        time, error = np.array(loop.time), np.degrees(np.array(loop.error))
        behind = (time > 8.0) & (np.maximum.accumulate(np.abs(error)) < 150.0)
        assert behind.any() and np.diff(np.array(loop.yaw)[behind]).min() > 0.0


@pytest.mark.parametrize('age', [0.1, 0.4])
@pytest.mark.parametrize(('own_deg', 'limit_deg'), [(45.0, 30.0), (90.0, 60.0)])
def test_irregular_bearings_make_it_swing_no_more(own_deg, limit_deg, age):
    """Intervals of 0.02 to 0.12 s, late by 0.02 s more or less, at 25 deg/s: what needless stops cost is made up for."""
    conditions = Conditions(bearing_age=age, bearing_rate=14.0, irregular=0.7, noise=NOISE, age_jitter=0.02, gain=0.93, seed=5)
    loop = close_loop(LimitedStage(own_deg, limit_deg), conditions,
                      lambda t: math.radians(25.0 * max(t - 1.0, 0.0)), 20.0)
    assert swing_deg(loop, 5.0) < 2.0 and loop.rms_deg(15.0) < 2.0


@pytest.mark.parametrize('age', [0.1, 0.4])
@pytest.mark.parametrize('limit_deg', [10.0, 15.0, 20.0])
def test_a_target_that_was_too_fast_is_caught_up_with(age, limit_deg):
    """At 25 deg/s for 4 s, then at 5 deg/s: the body turns on at its limit, arrives without passing it, and stays."""
    def target(t):
        return math.radians(25.0 * min(t, 4.0) + 5.0 * max(t - 4.0, 0.0))
    lag = 4.0 * (25.0 - 0.93 * limit_deg) + 0.5 * limit_deg
    arrival = 4.0 + lag / (0.93 * limit_deg - 5.0) + 4.0
    loop = close_loop(LimitedStage(45.0, limit_deg), Conditions(bearing_age=age, **FLOWN), target, arrival + 4.0)
    error = np.degrees(np.array(loop.error))
    assert error.max() > 15.0 and np.diff(loop.yaw).min() > -1e-4
    assert error.min() > -2.0 and swing_deg(loop, 4.0) < 2.0 and abs(error[-1]) < 2.0


class GuardedStage(LimitedStage):
    """Its commands reach the vehicle as the guard of px4_node lets them through."""

    def __init__(self, limit_deg):
        super().__init__(45.0, limit_deg)
        self._guard = BodyGuard(math.radians(limit_deg))

    def on_time(self, now):
        command = super().on_time(now)
        status = VehicleStatus(EXTERNAL_MODES[0] if self._guard.decision.reason != 'not started' else 4, True, False)
        inputs = Inputs(status, 0.0, 0.0, 0.0, 0.0, self._measured.age(now), command.yaw_rate, True, EXTERNAL_MODES[0], True)
        command.yaw_rate = self._guard.step(now.steady, inputs).yaw_rate
        return command


@pytest.mark.parametrize(('rate_deg', 'limit_deg', 'interval'), [
    (15.0, 30.0, 0.2), (20.0, 30.0, 0.2), (15.0, 20.0, 0.25), (23.0, 45.0, 0.12), (22.0, 30.0, 0.14)])
def test_measurements_far_apart_lose_no_target_within_what_they_allow(rate_deg, limit_deg, interval):
    """Driven at a rate r for an interval T, PX4 turns on by r 0.4 exp((T - 0.2) / 0.4): at 0.2 s, 24 deg/s are allowed."""
    for seed in range(3):
        conditions = Conditions(bearing_rate=1.0 / interval, noise=NOISE, gain=0.93, seed=seed)
        loop = close_loop(GuardedStage(limit_deg), conditions, lambda t: math.radians(rate_deg * max(t - 1.0, 0.0)), 20.0)
        assert swing_deg(loop, 5.0) < 2.0 and loop.rms_deg(15.0) < 2.0


class Undelayed(PointingController):
    """Follows the error as it is seen, and knows nothing of what has been commanded but not turned yet."""

    def step(self, time, track, ages, cue=None):
        if not hasattr(self, '_simple'):
            self._simple, self._before = LimitedAxis(AxisLimits(self.settings.yaw.rate, math.radians(180.0))), time
        dt, self._before = min(max(time - self._before, 0.0), 0.1), time
        if track is None:
            self._simple.stop(dt)
        else:
            rate = track.azimuth_world_rate
            self._simple.follow(float(wrap(track.azimuth + LEAD_S * (rate - self._simple.velocity))), rate, dt)
        return PointingCommand(yaw_rate=self._simple.velocity, move_body=True)


def test_a_controller_that_knows_nothing_of_delays_swings():
    """The tests above would fail without prediction."""
    stage = PointingStage(Undelayed(PointingSettings(move_gimbal=False)))
    loop = close_loop(stage, Conditions(bearing_age=0.3, **FULL), TARGETS['at rest'], 14.0)
    assert loop.rms_deg(8.0) > 5.0 and swing_deg(loop, 4.0) > 15.0


@pytest.mark.parametrize('until', [4.01, 4.03])
@pytest.mark.parametrize('rates', [(20.0, 50.0), (10.0, 50.0), (30.0, 10.0)])
def test_from_30_deg_a_second_the_body_turns_by_less_than_10_deg_after_0_3_s(until, rates):
    """The yaw rate is 0 within 0.3 s of the newest measurement's arrival; with the flown answer."""
    conditions = Conditions(bearing_rate=rates[0], odometry_rate=rates[1])
    loop = close_loop(make_stage(), conditions, lambda t: math.radians(30.0 * t), until + 3.5, until)
    assert 1.0 < loop.turned_deg(loop.newest + 0.3) < 10.0
    time, rate = np.array(loop.time), np.degrees(np.array(loop.command))
    assert np.all(rate[time > loop.newest + 0.3] == 0.0) and np.abs(rate[time < loop.newest]).max() > 29.0
    assert np.diff(loop.yaw).min() > -1e-4   # braking turns nothing back


@pytest.mark.parametrize('gain', [0.0, 0.5, 1.0])
def test_braking_turns_no_body_that_does_not_turn(gain):
    """A vehicle whose pilot holds it, or that turns less than it is told, is not turned the other way."""
    loop = close_loop(make_stage(), Conditions(gain=gain), lambda t: 1.0 + gain * math.radians(30.0) * t, 6.0, 4.0)
    assert np.diff(loop.yaw).min() > -1e-4
    assert gain > 0.0 or min(loop.command) == 0.0


class TestResponse:
    """What is learned of the vehicle."""

    @staticmethod
    def drive(motion, dead_time=0.1, lag=0.4, gain=1.0, seconds=20.0, period=0.02):
        """Rates that change each second and half; yaw measured with noise."""
        random, rate = np.random.default_rng(3), 0.0
        vehicle = YawAxis(YawResponse(math.inf, math.inf, dead_time, lag), 0.0, 0.0)
        for k in range(round(seconds / period)):
            time = 500.0 + k * period
            motion.measure(time, vehicle.step(period, time) + math.radians(0.1) * random.standard_normal())
            if k % 75 == 0:
                rate = math.radians(random.choice([-40.0, -15.0, 0.0, 10.0, 30.0]))
            motion.command(time, rate)
            vehicle.command(gain * rate, time)

    @pytest.mark.parametrize(('dead_time', 'lag', 'gain'), [(0.1, 0.4, 0.93), (0.0, 0.05, 1.0), (0.3, 0.8, 1.0)])
    def test_dead_time_lag_and_gain_are_found(self, dead_time, lag, gain):
        motion = BodyMotion()
        self.drive(motion, dead_time, lag, gain)
        found = motion.response
        assert found.dead_time + found.lag == pytest.approx(dead_time + lag, abs=0.06)
        assert found.lag == pytest.approx(lag, abs=0.1) and found.gain == pytest.approx(gain, abs=0.06)
        assert found.uncertainty < 0.06

    def test_a_vehicle_that_a_pilot_holds_teaches_nothing(self):
        motion = BodyMotion()
        self.drive(motion, gain=0.0)
        assert motion.following < 0.1
        assert motion.response.lag == pytest.approx(0.4, abs=0.05) and motion.response.uncertainty > 0.1

    def test_no_input_gives_anything_but_a_bounded_answer(self):
        random, motion = np.random.default_rng(1), BodyMotion(Response(0.0, 1.2))
        time = 1e5
        for _ in range(3000):
            time += random.choice([0.0, 0.01, 0.02, 0.3, 2.0, -0.5], p=[0.1, 0.3, 0.5, 0.06, 0.02, 0.02])
            motion.measure(time + random.normal(0.0, 0.1), random.choice([math.nan, 1e9, *random.normal(0.0, 3.0, 8)]))
            motion.command(time, float(random.normal()))
            answer = motion.response
            assert 0.0 <= answer.dead_time <= 0.6 and 0.0 < answer.lag <= 1.6 and 0.5 <= answer.gain <= 1.3
            assert math.isfinite(motion.ahead(time).yaw + motion.rate(time))
