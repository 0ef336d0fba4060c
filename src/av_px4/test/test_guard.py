"""What may be sent to turn the vehicle, over random histories of status, mode, staleness and loss."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from fake_autopilot import FakeAutopilot, wrap

from av_px4.guard import MARGIN, OFFBOARD, BodyGuard, GuardSettings, Inputs, VehicleStatus

SEQUENCES, STEPS = 10_000, 40
MODES = (0, 2, 4, 5, 14, 14, 14, 18, 23, 24)
STREAMS = ('status', 'attitude', 'position', 'command', 'bearing')
SETTINGS = GuardSettings()
TIMEOUTS = {'status': SETTINGS.status_timeout, 'attitude': SETTINGS.attitude_timeout,
            'position': SETTINGS.position_timeout, 'command': SETTINGS.command_timeout, 'bearing': SETTINGS.bearing_timeout}
GOOD = Inputs(VehicleStatus(OFFBOARD, True, False), 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, True, None, True, False)


def settle(guard, inputs, time, seconds=0.6):
    """Step at 50 Hz; the decisions."""
    return [guard.step(time + k * 0.02, inputs) for k in range(1, round(seconds / 0.02) + 1)]


def random_sequence(rng):
    """Steps (dt, inputs) of one history: streams that die and come back, modes that change, pilots that take over."""
    alive, ages = dict.fromkeys(STREAMS, True), dict.fromkeys(STREAMS, 0.0)
    status, fields = GOOD.status, {'yaw_rate': 0.5, 'move': True, 'own_mode': None, 'place_known': True,
                                   'unacknowledged': False}
    uniform, dts = rng.random((STEPS, 4)), rng.uniform(0.01, 0.05, STEPS)
    for k in range(STEPS):
        if uniform[k, 0] < 0.15:
            stream = STREAMS[int(uniform[k, 1] * 5)]
            alive[stream] = not alive[stream]
        if uniform[k, 2] < 0.2:
            choice, value = int(uniform[k, 3] * 8), uniform[k, 1]
            if choice < 3 and alive['status']:
                status = VehicleStatus(MODES[int(value * len(MODES))], value < 0.9, value > 0.95)
            elif choice < 5:
                fields['yaw_rate'] = (math.nan, math.inf, -9.0, 9.0, 0.3, -0.4, 0.0)[int(value * 7)]
            else:
                name = ('move', 'place_known', 'unacknowledged')[choice - 5]
                fields[name] = value < 0.5
                fields['own_mode'] = (None, 23, 5)[int(value * 3)]
        ages = {name: 0.0 if alive[name] else ages[name] + dts[k] for name in STREAMS}
        yield dts[k], Inputs(status, ages['status'], ages['attitude'], ages['position'], ages['command'], ages['bearing'],
                             **fields)


def test_no_history_leads_to_harm():
    """10,000 random histories: allowed modes only, within the limits, still within 0.3 s of staleness, and it recovers."""
    rng, turned, refused = np.random.default_rng(7), 0, 0
    for number in range(SEQUENCES):
        guard, time = BodyGuard(SETTINGS), 1234.5 + number
        sent, previous, bad_since = 0.0, None, dict.fromkeys((*STREAMS, 'asked'), None)
        for dt, inputs in random_sequence(rng):
            time += dt
            decision = guard.step(time, inputs)
            allowed = (inputs.status_age <= 1.5 and not inputs.status.failsafe and (
                inputs.status.nav_state == 14 or (inputs.own_mode == 23 and inputs.status.nav_state == 23)))
            assert not decision.setpoint or allowed
            refused += not decision.setpoint
            if decision.setpoint:
                assert abs(decision.yaw_rate) <= SETTINGS.max_rate + 1e-12
                before = 0.0 if previous is None else previous
                assert abs(decision.yaw_rate - before) <= SETTINGS.max_acceleration * dt + 1e-9
                newest = max(inputs.command_age, inputs.bearing_age, inputs.attitude_age)
                assert decision.yaw_rate == 0.0 or newest < 0.3 - MARGIN    # the next step comes within MARGIN
                sent = decision.yaw_rate
                turned += sent != 0.0
            previous = decision.yaw_rate if decision.setpoint else None
            if not allowed and inputs.status_age <= 1.5:
                sent = 0.0    # the pilot or PX4 flies; what was sent before counts no more
            bad = {name: getattr(inputs, f'{name}_age') > TIMEOUTS[name] for name in STREAMS}
            bad['asked'] = not inputs.move or inputs.unacknowledged or not math.isfinite(inputs.yaw_rate)
            for name, is_bad in bad.items():
                bad_since[name] = (time if bad_since[name] is None else bad_since[name]) if is_bad else None
                # a place once held stays known; the histories here that lose it are stricter than the node can be
                if bad_since[name] is not None and time - bad_since[name] >= 0.3 and inputs.place_known:
                    assert sent == 0.0, (number, name)
        decisions = settle(guard, GOOD, time)
        assert decisions[-1].yaw_rate == pytest.approx(0.5) and decisions[-1].heartbeat
    assert turned > SEQUENCES and refused > SEQUENCES   # the histories do reach motion and refusal


class TestOneByOne:
    @pytest.mark.parametrize('mode', [mode for mode in range(32) if mode != OFFBOARD])
    def test_in_no_other_mode_is_anything_sent(self, mode):
        guard = BodyGuard()
        settle(guard, GOOD, 0.0)
        assert not any(d.setpoint for d in settle(guard, replace(GOOD, status=VehicleStatus(mode, True, False)), 1.0))

    @pytest.mark.parametrize('own', [5, 2, 14, 31, -1])
    def test_a_registration_cannot_claim_one_of_px4s_own_modes(self, own):
        inputs = replace(GOOD, status=VehicleStatus(own if own != 14 else 4, True, False), own_mode=own)
        assert not any(d.setpoint for d in settle(BodyGuard(), inputs, 0.0))

    def test_the_own_mode_is_as_good_as_offboard(self):
        inputs = replace(GOOD, status=VehicleStatus(23, True, False), own_mode=23)
        assert settle(BodyGuard(), inputs, 0.0)[-1].yaw_rate == pytest.approx(0.5)

    def test_before_the_first_status_nothing_is_sent(self):
        decision = BodyGuard().step(0.0, replace(GOOD, status=None))
        assert not decision.setpoint and not decision.heartbeat

    def test_the_heartbeat_comes_before_the_mode(self):
        decisions = settle(BodyGuard(), replace(GOOD, status=VehicleStatus(4, True, False)), 0.0)
        assert all(d.heartbeat and not d.setpoint for d in decisions)

    def test_a_stale_bearing_or_a_disabled_rig_keeps_offboard_and_holds(self):
        for inputs in (replace(GOOD, bearing_age=1.0), replace(GOOD, move=False)):
            guard = BodyGuard()
            settle(guard, GOOD, 0.0)
            decisions = settle(guard, inputs, 0.6, 0.3)
            assert all(d.heartbeat and d.setpoint for d in decisions) and decisions[-1].yaw_rate == 0.0

    def test_without_a_position_offboard_is_not_even_offered(self):
        decision = BodyGuard().step(0.0, replace(GOOD, place_known=False))
        assert not decision.heartbeat and not decision.setpoint

    def test_a_silent_status_brakes_before_it_is_stale(self):
        guard, sent = BodyGuard(), []
        for k in range(150):
            decision = guard.step(0.02 * k, replace(GOOD, status_age=max(0.0, 0.02 * k - 1.0)))
            if decision.setpoint:
                sent.append(decision.yaw_rate)
        assert sent[50] == pytest.approx(0.5) and sent[-1] == 0.0 and len(sent) < 130

    def test_after_a_stall_of_its_own_it_waits_for_a_new_status(self):
        """Whatever PX4 said meanwhile may still be in a queue, while the last status looks fresh."""
        guard = BodyGuard()
        settle(guard, GOOD, 0.0)
        decision = guard.step(1.5, replace(GOOD, status_age=0.9))
        assert decision.heartbeat and not decision.setpoint
        assert not guard.step(1.52, replace(GOOD, status_age=0.92)).setpoint
        assert guard.step(1.6, replace(GOOD, status_age=0.05)).setpoint

    @pytest.mark.parametrize('silent', [('command_age',), ('bearing_age',), ('command_age', 'bearing_age')])
    @pytest.mark.parametrize('late', [0.0, 0.01, 0.02, 0.03])
    def test_from_30_deg_a_second_px4_turns_by_less_than_10_deg_after_0_3_s(self, silent, late):
        """With the flown answer, whoever dies, and whatever is commanded on."""
        guard, autopilot, yaws = BodyGuard(), FakeAutopilot(nav_state=OFFBOARD), []
        for k in range(1000):
            time, age = 0.005 * k, max(0.0, 0.005 * k - 2.0)
            if k % 4 == 0:
                ages = dict.fromkeys(silent, age + (late if age else 0.0))
                decision = guard.step(time, replace(GOOD, yaw_rate=math.radians(30.0), **ages))
                autopilot.heartbeat()
                autopilot.setpoint((0.0, 0.0, -2.0), math.nan, decision.yaw_rate)
            autopilot.advance(0.005)
            yaws.append(autopilot.heading)
        assert autopilot.yaw_rate == 0.0
        assert 1.0 < math.degrees(wrap(yaws[-1] - yaws[round((2.3 - late) / 0.005)])) < 10.0

    def test_a_fast_body_may_be_braked_with_an_old_measurement(self):
        guard = BodyGuard()
        settle(guard, GOOD, 0.0)
        rates = [guard.step(0.6 + 0.01 * k, replace(GOOD, yaw_rate=-0.2 if k > 15 else 0.5, bearing_age=0.01 * k)).yaw_rate
                 for k in range(1, 40)]
        assert rates[4] > 0.3 and min(rates[:24]) < -0.1 and not any(rates[25:])

    def test_disarmed_nothing_turns(self):
        assert settle(BodyGuard(), replace(GOOD, status=VehicleStatus(14, False, False)), 0.0)[-1].yaw_rate == 0.0

    def test_limits_that_cannot_stop_in_time_are_refused(self):
        with pytest.raises(ValueError, match='max_acceleration 100.0 deg/s'):
            GuardSettings(max_rate=math.radians(45), max_acceleration=math.radians(100))
        with pytest.raises(ValueError, match='status_timeout is 0.5'):
            GuardSettings(status_timeout=0.5)
