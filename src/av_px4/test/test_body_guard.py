"""The guard alone: thousands of random histories of its inputs, and cases that a stage is not easily brought to."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from fake_autopilot import FakeAutopilot, wrap

from av_common.stopping import STOP_WITHIN
from av_px4.guard import (
    ATTITUDE_TIMEOUT,
    COMMAND_TIMEOUT,
    MARGIN,
    MAX_ACCELERATION,
    POSITION_TIMEOUT,
    STATUS_TIMEOUT,
    BodyGuard,
    Inputs,
)
from av_px4.handover import OFFBOARD, VehicleStatus

SEQUENCES, STEPS = 2_000, 60
MODES = (2, 4, 5, 14, 14, 14, 18, 23, 23, 24)
STREAMS = ('status', 'attitude', 'position', 'command', 'bearing')
MAX_RATE = math.radians(30.0)
TIMEOUTS = {'status': STATUS_TIMEOUT, 'attitude': ATTITUDE_TIMEOUT, 'position': POSITION_TIMEOUT,
            'command': COMMAND_TIMEOUT, 'bearing': STOP_WITHIN}
GOOD = Inputs(VehicleStatus(OFFBOARD, True, False), 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, True, None, True)


def settle(guard, inputs, time, seconds=0.6):
    """Step at 50 Hz; the decisions."""
    return [guard.step(time + k * 0.02, inputs) for k in range(1, round(seconds / 0.02) + 1)]


def handed_over(inputs=GOOD, time=0.0, **options):
    """A guard whose vehicle held before `time` (s), and is what `inputs` say since then."""
    guard = BodyGuard(**{'offboard': True, **options})
    settle(guard, replace(inputs, status=VehicleStatus(4, True, False)), time - 1.0, 1.0)
    return guard


def random_sequence(rng):
    """Steps (dt, inputs) of one history: streams that die and come back, modes that change, pilots that take over."""
    alive, ages = dict.fromkeys(STREAMS, True), dict.fromkeys(STREAMS, 0.0)
    status, fields = GOOD.status, {'yaw_rate': 0.5, 'enabled': True, 'own_mode': None, 'place_known': True, 'others': '',
                                   'unacknowledged': False}
    uniform, dts = rng.random((STEPS, 4)), rng.uniform(0.01, 0.05, STEPS)
    for k in range(STEPS):
        if uniform[k, 0] < 0.15:
            stream = STREAMS[int(uniform[k, 1] * 5)]
            alive[stream] = not alive[stream]
        if uniform[k, 2] < 0.25:
            choice, value = int(uniform[k, 3] * 9), uniform[k, 1]
            if choice < 4 and alive['status']:
                status = VehicleStatus(MODES[int(value * len(MODES))], value < 0.95, 0.4 < value < 0.5)
            elif choice < 5:
                fields['yaw_rate'] = (math.nan, math.inf, -9.0, 9.0, 0.3, -0.4, 0.0)[int(value * 7)]
            elif choice == 8:
                fields['others'] = '/other publishes trajectory_setpoint' if value < 0.3 else ''
            else:
                name = ('enabled', 'place_known', 'unacknowledged')[choice - 5]
                fields[name] = value < (0.2 if name == 'unacknowledged' else 0.8)
                fields['own_mode'] = (None, 23, 5)[int(value * 3)]
        ages = {name: 0.0 if alive[name] else ages[name] + dts[k] for name in STREAMS}
        yield dts[k], Inputs(status, ages['status'], ages['attitude'], ages['position'], ages['command'], ages['bearing'],
                             **fields)


class Consent:
    """Whether the pilot has handed over, told again: he came from another mode without a failsafe, to a rig that offered."""

    def __init__(self):
        self.before, self.given = None, False

    def update(self, status, offered):
        if status != self.before:
            if self.before is None or status.nav_state != self.before.nav_state:
                self.given = (self.before is not None and not self.before.failsafe
                              and (status.nav_state != OFFBOARD or offered))
            self.given &= not status.failsafe
            self.before = status


def test_no_history_leads_to_harm():
    """Random histories: handed-over modes only, within the limits, still within 0.3 s of staleness, and it recovers."""
    rng, turned, refused = np.random.default_rng(7), 0, 0
    for number in range(SEQUENCES):
        guard, consent, time = BodyGuard(offboard=True), Consent(), 1234.5 + number
        sent, previous, offered, bad_since = 0.0, None, False, dict.fromkeys((*STREAMS, 'asked'), None)
        for dt, inputs in random_sequence(rng):
            time += dt
            inputs = replace(inputs, place_known=inputs.place_known or previous is not None)    # what is held stays known
            consent.update(inputs.status, offered)
            decision = guard.step(time, inputs)
            offered = decision.heartbeat
            mode = (inputs.status_age <= STATUS_TIMEOUT and not inputs.status.failsafe and (
                inputs.status.nav_state == 14 or (inputs.own_mode == 23 and inputs.status.nav_state == 23)))
            assert not decision.setpoint or mode
            assert not decision.heartbeat or not (inputs.others or inputs.status.failsafe)
            if inputs.others or (mode and not consent.given):    # at most what ends the turn before
                assert not decision.setpoint or (decision.yaw_rate == 0.0 and previous)
            refused += not decision.setpoint
            if decision.setpoint:
                assert abs(decision.yaw_rate) <= MAX_RATE + 1e-12
                before = 0.0 if previous is None else previous
                change = abs(decision.yaw_rate - before) if decision.reason != inputs.others else 0.0
                assert change <= MAX_ACCELERATION * dt + 1e-9 or 'select another mode' in decision.reason
                newest = max(inputs.command_age, inputs.bearing_age, inputs.attitude_age)
                assert decision.yaw_rate == 0.0 or newest < 0.3 - MARGIN    # the next step comes within MARGIN
                sent = decision.yaw_rate
                turned += sent != 0.0
            previous = decision.yaw_rate if decision.setpoint else None
            if not mode and inputs.status_age <= STATUS_TIMEOUT:
                sent = 0.0    # the pilot or PX4 flies; what was sent before counts no more
            bad = {name: getattr(inputs, f'{name}_age') > TIMEOUTS[name] for name in STREAMS}
            bad['asked'] = not inputs.enabled or inputs.unacknowledged or not math.isfinite(inputs.yaw_rate)
            for name, is_bad in bad.items():
                bad_since[name] = (time if bad_since[name] is None else bad_since[name]) if is_bad else None
                if bad_since[name] is not None and time - bad_since[name] >= 0.3:
                    assert sent == 0.0, (number, name)
        settle(guard, replace(GOOD, status=VehicleStatus(4, True, False)), time)
        decisions = settle(guard, GOOD, time + 0.6)
        assert decisions[-1].yaw_rate == pytest.approx(0.5) and decisions[-1].heartbeat
    assert turned > 0.95 * SEQUENCES and refused > SEQUENCES   # the histories do reach motion and refusal


@pytest.mark.parametrize('own', [5, 2, 14, 31, -1])
def test_a_registration_cannot_claim_one_of_px4s_own_modes(own):
    inputs = replace(GOOD, status=VehicleStatus(own if own != 14 else 4, True, False), own_mode=own)
    assert not any(d.setpoint for d in settle(handed_over(inputs), inputs, 0.0))


def test_the_own_mode_is_as_good_as_offboard():
    inputs = replace(GOOD, status=VehicleStatus(23, True, False), own_mode=23)
    for offboard in (False, True):
        assert settle(handed_over(inputs, offboard=offboard), inputs, 0.0)[-1].yaw_rate == pytest.approx(0.5)


def test_before_the_first_status_nothing_is_sent():
    decision = BodyGuard().step(0.0, replace(GOOD, status=None))
    assert not decision.setpoint and not decision.heartbeat


def test_the_heartbeat_comes_before_the_mode_and_not_before_pointing_is_enabled():
    hover = replace(GOOD, status=VehicleStatus(4, True, False))
    assert all(d.heartbeat and not d.setpoint for d in settle(BodyGuard(offboard=True), hover, 0.0)[6:])
    for off in ({'enabled': False}, {'command_age': 0.3}):
        assert not any(d.heartbeat for d in settle(BodyGuard(offboard=True), replace(hover, **off), 0.0))


def test_a_stale_bearing_or_a_disabled_rig_keeps_offboard_and_holds():
    for inputs in (replace(GOOD, bearing_age=1.0), replace(GOOD, enabled=False)):
        guard = handed_over()
        settle(guard, GOOD, 0.0)
        decisions = settle(guard, inputs, 0.6, 0.3)
        assert all(d.heartbeat and d.setpoint for d in decisions) and decisions[-1].yaw_rate == 0.0


def test_without_a_position_offboard_is_not_even_offered():
    decision = settle(BodyGuard(offboard=True), replace(GOOD, place_known=False), 0.0)[-1]
    assert not decision.heartbeat and not decision.setpoint


def test_after_a_stall_of_its_own_it_waits_for_a_new_status():
    """Whatever PX4 said meanwhile may still be in a queue, while the last status looks fresh: no heartbeat, either."""
    guard = handed_over()
    settle(guard, GOOD, 0.0)
    for time, age in ((1.5, 0.9), (1.52, 0.92), (1.56, 0.01)):
        decision = guard.step(time, replace(GOOD, status_age=age))
        assert not decision.heartbeat and not decision.setpoint
    assert guard.step(1.65, replace(GOOD, status_age=0.1)).setpoint


def test_others_end_a_turn_with_one_setpoint():
    guard = handed_over()
    settle(guard, GOOD, 0.0)
    first, *rest = settle(guard, replace(GOOD, others='/other publishes goto_setpoint'), 0.6)
    assert (first.setpoint, first.yaw_rate, first.heartbeat) == (True, 0.0, False)
    assert not any(d.setpoint or d.heartbeat for d in rest) and rest[0].reason == '/other publishes goto_setpoint'


@pytest.mark.parametrize('silent', [('command_age',), ('bearing_age',), ('command_age', 'bearing_age')])
@pytest.mark.parametrize('late', [0.0, 0.01, 0.03])
@pytest.mark.parametrize('rate_deg', [18.0, 24.0, 30.0])
def test_px4_turns_by_less_than_10_deg_after_0_3_s(silent, late, rate_deg):
    """With the flown answer, whoever dies, and whatever is commanded on."""
    guard, autopilot, yaws = handed_over(), FakeAutopilot(nav_state=OFFBOARD), []
    for k in range(1000):
        time, age = 0.005 * k, max(0.0, 0.005 * k - 2.0)
        if k % 4 == 0:
            ages = dict.fromkeys(silent, age + (late if age else 0.0))
            decision = guard.step(time, replace(GOOD, yaw_rate=math.radians(rate_deg), **ages))
            autopilot.heartbeat()
            autopilot.setpoint((0.0, 0.0, -2.0), math.nan, decision.yaw_rate)
        autopilot.advance(0.005)
        yaws.append(autopilot.heading)
    assert autopilot.yaw_rate == 0.0
    assert 1.0 < math.degrees(wrap(yaws[-1] - yaws[round((2.3 - late) / 0.005)])) < 10.0


def test_disarmed_nothing_turns():
    disarmed = replace(GOOD, status=VehicleStatus(14, False, False))
    assert settle(handed_over(disarmed), disarmed, 0.0)[-1].yaw_rate == 0.0
