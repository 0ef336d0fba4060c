"""What is sent to turn the vehicle, over random histories of status, mode, staleness, others, and loss."""

from __future__ import annotations

import math

import numpy as np
import pytest
from flight_bench import Flight
from test_px4_stage import HOLD, OFFBOARD, Rig, parameters

from av_px4.stage import Px4Stage

SEQUENCES, STEPS = 150, 90
STEP = 0.02                              # s
MAX_RATE, MAX_CHANGE = math.radians(30.0), math.radians(900.0) * STEP
STREAMS = ('vehicle_status', 'vehicle_odometry', 'vehicle_local_position', 'command', 'bearing')
LIMITS = dict(zip(STREAMS, (1.5, 0.2, 0.5, 0.25, 0.3), strict=True))    # s, age from which each is stale
MODES = (2, 4, 5, 14, 14, 14, 18, 23)
OTHERS = '/other publishes trajectory_setpoint'


class Chance(Rig):
    """A rig whose streams die and come back, whose modes change, and whose pilot takes over."""

    def __init__(self, rng):
        super().__init__()
        self.rng, self.command, self.answers, self.answered = rng, {'yaw_rate': 0.5, 'move_body': True}, False, math.nan
        self.heard, self.wanted = dict.fromkeys(STREAMS, -math.inf), self.time
        self.told, self.given = None, False    # the newest status, and whether the pilot has handed over by it

    def take(self, name, message):
        if name in self.heard and name not in self.silent:
            self.heard[name] = self.time
        if name == 'vehicle_status' and name not in self.silent:
            status = message.nav_state, message.failsafe
            if self.told is None or status[0] != self.told[0]:
                self.given = self.told is not None and not self.told[1] and self.offers
            self.given &= not status[1]
            self.told = status
        super().take(name, message)

    @property
    def offers(self):
        """Whether the heartbeat was sent in the step before."""
        return bool(self.of('offboard_control_mode', self.time - 1.5 * STEP))

    def happen(self):
        kind, value = self.rng.random(2).tolist()
        if kind < 0.35:
            self.silent ^= {STREAMS[int(value * 5)]}
        elif kind < 0.55:
            self.nav_state, self.failsafe = MODES[int(value * len(MODES))], 0.4 < value < 0.45
        elif kind < 0.7:
            self.command['yaw_rate'] = (math.nan, math.inf, -9.0, 9.0, 0.3, -0.4, 0.0)[int(value * 7)]
        elif kind < 0.78:
            self.command['move_body'] = value < 0.8
        elif kind < 0.86:
            self.stage.others = OTHERS if value < 0.3 else ''
        elif kind < 0.93:
            self.valid = value < 0.8
        else:
            self.answers = value < 0.6

    def step(self):
        """The setpoint and the heartbeat that are sent, None without."""
        if self.rng.random() < 0.12:
            self.happen()
        self.run(STEP, **self.command)
        if self.answers and self.of('vehicle_command', self.time):
            self.answered = self.time
            self.acknowledge()
        usable = self.command['move_body'] and math.isfinite(self.command['yaw_rate'])
        self.wanted = self.time if usable or 'command' in self.silent else self.wanted
        return [next(iter(self.of(topic, self.time)), None) for topic in ('trajectory_setpoint', 'offboard_control_mode')]

    def ages(self):
        """Time (s) since each stream was last heard."""
        return {name: self.time - heard for name, heard in self.heard.items()}


def test_no_history_leads_to_harm():
    """Random histories: handed-over modes only, within the limits, still within 0.3 s of staleness, and it recovers."""
    rng, turned, refused = np.random.default_rng(7), 0, 0
    for number in range(SEQUENCES):
        rig, before, steered = Chance(rng), 0.0, False
        rig.run(0.1, **rig.command)
        rig.nav_state = OFFBOARD
        for _ in range(STEPS):
            setpoint, heartbeat = rig.step()
            rate = 0.0 if setpoint is None or math.isnan(setpoint.yawspeed) else -setpoint.yawspeed
            ages, (mode, failsafe) = rig.ages(), rig.told or (None, True)
            assert setpoint is None or (ages['vehicle_status'] <= 1.5 and mode == OFFBOARD and not failsafe)
            assert heartbeat is None or not (rig.stage.others or failsafe)
            if rig.stage.others or not rig.given:    # at most what ends the turn before
                assert setpoint is None or (rate == 0.0 and steered), number
            assert abs(rate) <= MAX_RATE + 1e-9
            assert setpoint is None or abs(rate - before) <= MAX_CHANGE + 1e-9 or rate == 0.0
            if rate:
                assert all(ages[name] < LIMITS[name] + 2.5 * STEP for name in STREAMS), number    # from the highest rate
                assert max(ages['command'], ages['bearing'], ages['vehicle_odometry']) < 0.25
                assert rig.time - rig.wanted < 0.1 + STEP and not rig.time - rig.answered > 1.4
            before, steered = rate, setpoint is not None
            turned, refused = turned + (rate != 0.0), refused + (setpoint is None)
        rig.silent, rig.stage.others, rig.failsafe, rig.valid, rig.nav_state = set(), '', False, True, HOLD
        rig.point(1.0, yaw_rate=0.5)
        rig.nav_state = OFFBOARD
        rig.point(0.6, yaw_rate=0.5)
        assert rig.of('trajectory_setpoint')[-1].yawspeed == pytest.approx(-0.5), number
    assert turned > 5 * SEQUENCES and refused > SEQUENCES    # the histories do reach motion and refusal


def turning(**changes):
    """A rig that turns in OFFBOARD."""
    rig = Rig(**changes)
    rig.hand_over()
    rig.run(0.6, yaw_rate=0.5)
    assert rig.of('trajectory_setpoint')[-1].yawspeed == pytest.approx(-0.5)
    return rig


@pytest.mark.parametrize('mode', [mode for mode in range(32) if mode != OFFBOARD])
def test_in_no_other_mode_is_anything_sent(mode):
    rig = turning()
    rig.nav_state = mode
    rig.run(0.6, yaw_rate=0.5)
    assert not rig.of('trajectory_setpoint', rig.time - 0.55)


def test_offboard_is_not_taken_unless_it_was_asked_for():
    rig = Rig(offboard=False)
    rig.hand_over()
    rig.run(1.0, yaw_rate=0.5)
    assert not rig.of('trajectory_setpoint') and not rig.of('offboard_control_mode')


def test_a_silent_status_brakes_before_it_is_stale():
    rig = turning()
    rig.silent, began = {'vehicle_status'}, rig.time
    rig.run(2.5, yaw_rate=0.5)
    sent = [(time - began, message) for time, topic, message in rig.sent if topic == 'trajectory_setpoint' and time > began]
    assert sent[50][1].yawspeed == pytest.approx(-0.5) and math.isnan(sent[-1][1].yawspeed) and sent[-1][0] <= 1.5


def test_a_mode_that_was_left_unseen_is_not_taken_again():
    """PX4 numbers each activation by its time."""
    rig = turning()
    rig.activated, began = 5, rig.time + STEP
    rig.run(1.0, yaw_rate=0.5)
    sent = rig.of('trajectory_setpoint', began)
    assert len(sent) <= 1 and not rig.of('offboard_control_mode', began + STEP)


@pytest.mark.parametrize('wait', [0.04, 0.2])
def test_after_a_stall_of_its_own_it_waits_for_what_px4_said_meanwhile(wait):
    """It may still be in a queue, while the last status looks fresh: no heartbeat, either."""
    rig = turning()
    rig.silent = {'vehicle_status'}
    rig.run(0.3, yaw_rate=0.5)
    rig.time, began = rig.time + 0.9, rig.time + 0.91
    rig.run(wait, yaw_rate=0.5)
    if wait < 0.1:    # the queues may not be empty yet
        rig.silent = set()
        rig.run(0.06, yaw_rate=0.5)
    assert not rig.of('trajectory_setpoint', began) and not rig.of('offboard_control_mode', began)
    rig.silent = set()
    rig.run(0.3, yaw_rate=0.5)
    assert rig.of('trajectory_setpoint', began)


@pytest.mark.parametrize('silent', [{'command'}, {'bearing'}, {'command', 'bearing'}])
@pytest.mark.parametrize('rate_deg', [18.0, 24.0, 30.0])
def test_px4_turns_by_less_than_10_deg_after_0_3_s(silent, rate_deg):
    """With the flown answer, whoever dies, and whatever is commanded on."""
    flight, turn = Flight(offboard=True), {'yaw_rate': math.radians(rate_deg)}
    flight.pilot = OFFBOARD
    flight.run(5.0, **turn)
    flight.silent = silent
    flight.run(0.3, **turn)
    turned = flight.model.turned
    flight.run(4.0, **turn)
    assert flight.model.yaw_rate == 0.0 and 1.0 < math.degrees(turned - flight.model.turned) < 10.0


def test_a_fast_body_may_be_braked_with_an_old_measurement():
    rig = turning()
    rig.silent, began = {'bearing'}, rig.time
    rig.run(0.14, yaw_rate=0.5)
    rig.run(0.4, yaw_rate=-0.2)
    rates = {round(time - began, 2): -message.yawspeed for time, topic, message in rig.sent
             if topic == 'trajectory_setpoint' and time > began}
    assert rates[0.04] > 0.3 and min(rate for time, rate in rates.items() if time < 0.24) < -0.1
    assert all(math.isnan(rate) for time, rate in rates.items() if time > 0.26)


@pytest.mark.parametrize('rate_deg', [0.0, -5.0, 101.0, math.nan])
def test_rates_from_which_it_cannot_stop_in_time_are_refused(rate_deg):
    settings = parameters()
    settings.body.rate_deg = rate_deg
    with pytest.raises(ValueError, match='a yaw rate of'):
        Px4Stage(settings, None)
