"""Claiming, pointing and giving back the gimbal, against the fake autopilot and at random."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fake_autopilot import HOLD, RETURN
from gimbal_bench import OWN, Bench

from av_px4.commands import GIMBAL_CONFIGURE, GIMBAL_PITCH_YAW, Command
from av_px4.gimbal import AfterTakeover, Claim


class TestClaim:
    def test_claims_before_it_points_and_is_never_denied(self):
        bench = Bench()
        bench.run(2.0, pan=0.5)
        assert [command.command for _, command in bench.sent[:2]] == [GIMBAL_CONFIGURE, GIMBAL_PITCH_YAW]
        assert bench.autopilot.owner == OWN and bench.autopilot.denied == 0 and bench.client.claim is Claim.OWNED

    @pytest.mark.parametrize(('pan', 'tilt'), [(40.0, 25.0), (130.0, 25.0), (-130.0, -20.0), (-40.0, -20.0)])
    def test_the_gimbal_looks_where_it_is_told(self, pan, tilt):
        bench = Bench()
        bench.run(3.0, math.radians(pan), math.radians(tilt))
        assert bench.looks == pytest.approx((pan, tilt), abs=0.1)

    def test_return_to_launch_takes_the_gimbal_and_afterwards_it_is_claimed_again(self):
        bench = Bench()
        bench.run(2.0, pan=0.5)
        bench.autopilot.change_mode(RETURN, 'the pilot')
        count = len(bench.sent)
        bench.run(3.0, pan=0.5)
        assert len(bench.sent) == count and bench.looks[0] == pytest.approx(0.0)   # PX4's own business is not disturbed
        bench.autopilot.change_mode(HOLD, 'the pilot')
        bench.run(3.0, pan=0.5)
        assert bench.autopilot.owner == OWN and bench.looks[0] == pytest.approx(math.degrees(0.5), abs=0.1)

    def test_after_a_takeover_by_somebody_else_it_stops_and_asks_again(self):
        bench = Bench()
        bench.run(2.0, pan=0.5)
        bench.autopilot.owner = (255, 190)
        count = len(bench.sent)
        bench.run(0.9, pan=0.5)
        assert len(bench.sent) == count + 1 and bench.client.takeovers == 1   # the one that was denied
        bench.run(2.0, pan=0.5)
        assert bench.autopilot.owner == OWN

    @pytest.mark.parametrize('after', [AfterTakeover.WHEN_ASKED, AfterTakeover.NEVER])
    def test_who_took_it_keeps_it_until_pointing_is_asked_again_or_for_good(self, after):
        bench = Bench({'after_takeover': after})
        bench.run(2.0, pan=0.5)
        bench.autopilot.owner = (255, 190)
        bench.run(20.0, pan=0.5)
        assert bench.autopilot.owner == (255, 190) and bench.client.state == 'left to another, who took it'
        bench.run(1.0, move=False)
        assert bench.autopilot.owner == (255, 190)    # nothing of the rig's to give back
        bench.run(2.0, pan=0.5)
        assert (bench.autopilot.owner == OWN) == (after is AfterTakeover.WHEN_ASKED)

    def test_px4s_own_use_is_no_takeover(self):
        """The denial may come before the status that says so."""
        bench = Bench({'after_takeover': AfterTakeover.NEVER})
        bench.run(2.0, pan=0.5)
        bench.autopilot.owner = None
        bench.run(0.1, pan=0.5)
        bench.autopilot.change_mode(RETURN, 'the pilot')
        bench.run(3.0, pan=0.5)
        bench.autopilot.change_mode(HOLD, 'the pilot')
        bench.run(3.0, pan=0.5)
        assert bench.autopilot.owner == OWN

    def test_without_a_gimbal_input_it_asks_once_a_second_and_never_points(self):
        bench = Bench(gimbal_input=False)
        bench.run(5.0, pan=0.5)
        assert {command.command for _, command in bench.sent} == {GIMBAL_CONFIGURE} and len(bench.sent) in (5, 6)
        assert not bench.client.unacknowledged    # nothing was ever acknowledged: there is no link to have been lost

    def test_lost_acknowledgements_stop_it_and_are_told(self):
        bench = Bench()
        bench.run(2.0, pan=0.5)
        bench.autopilot.acknowledges = False
        bench.run(2.0, pan=0.5)
        pointed = [time for time, command in bench.sent if command.command == GIMBAL_PITCH_YAW]
        assert bench.client.unacknowledged and pointed[-1] <= 3.05
        bench.autopilot.acknowledges = True
        bench.run(2.0, pan=0.5)
        assert not bench.client.unacknowledged and bench.client.claim is Claim.OWNED

    def test_a_firmware_that_acknowledges_nothing_can_be_pointed_if_asked_for(self):
        bench = Bench({'need_ack': False}, acknowledges=False)
        bench.run(1.0, pan=0.5)
        assert bench.sent[-1][1].command == GIMBAL_PITCH_YAW

    def test_it_is_given_back_when_disabled_and_when_stopped(self):
        bench = Bench()
        bench.run(1.0)
        bench.run(1.0, move=False)
        assert bench.autopilot.owner is None and bench.client.claim is Claim.NONE
        bench.run(1.0)
        bench.deliver(bench.client.release())
        assert bench.autopilot.owner is None and not bench.client.release()

    def test_after_a_silence_of_the_status_it_begins_at_rest(self):
        """It was turning at 120 deg/s, which its gimbal does not any more."""
        bench = Bench()
        bench.run(0.5, pan=2.0)
        bench.autopilot.nav_state = None
        bench.run(2.0, pan=2.0)
        bench.autopilot.nav_state, count = HOLD, len(bench.sent)
        last = bench.sent[-1][1].params[1]
        bench.run(0.02, pan=2.0)
        assert 0.0 < last - bench.sent[count][1].params[1] <= 600.0 * 0.02**2 + 1e-6

    def test_it_begins_where_the_gimbal_looks(self):
        bench = Bench()
        bench.autopilot.gimbal, bench.autopilot.gimbal_wanted = [0.0, -1.0], [0.0, -1.0]
        bench.run(0.1, pan=1.0, measured=(1.0, 0.0))
        assert bench.sent[1][1].params[1] == pytest.approx(-math.degrees(1.0))


class TestRules:
    @pytest.mark.parametrize('number', [16, 20, 21, 22, 115, 176, 192, 400])
    def test_no_other_command_can_be_made(self, number):
        """Arming is 400, changing the mode 176, moving the vehicle 192."""
        with pytest.raises(ValueError, match='allowed'):
            Command(number, (0.0,) * 7)


class Chance:
    """A bench with random events: staleness, takeovers, modes, lost acknowledgements, jumping targets."""

    def __init__(self, rng, steps):
        self.bench, self.events = Bench(), rng.random((steps, 4)).tolist()
        self.fresh, self.stale, self.pan, self.tilt, self.move = True, 0.0, 0.0, 0.0, True

    def happen(self, what, value, width):
        if what < 0.3:
            self.fresh = not self.fresh
        elif what < 0.6:
            self.pan, self.tilt = 8.0 * value - 4.0, 4.0 * width - 2.0
        elif what < 0.7:
            self.bench.autopilot.change_mode(RETURN if value < 0.5 else HOLD, 'chance')
        elif what < 0.8:
            self.bench.autopilot.owner = (255, 190)
        elif what < 0.9:
            self.bench.autopilot.acknowledges = value < 0.5
        else:
            self.move = value < 0.5

    def run(self):
        """Yield for each step how long the inputs have been stale (s) and what was sent."""
        for happens, what, value, width in self.events:
            if happens < 0.2:
                self.happen(what, value, width)
            self.stale = 0.0 if self.fresh else self.stale + 0.02
            count = len(self.bench.sent)
            self.bench.run(0.02, math.nan if value < 0.01 else self.pan, self.tilt, self.move, self.fresh)
            yield self.stale, self.bench.sent[count:]


def check(stale, time, command, last):
    """The command obeys its limits; returns time, angles and rates (deg) for the next one."""
    if command.command != GIMBAL_PITCH_YAW:
        return None    # a claim may begin elsewhere
    pitch, yaw = command.params[:2]
    assert stale < 0.3 + 1e-9 and math.degrees(-1.5) <= pitch <= math.degrees(0.8) and abs(yaw) <= 155.0
    if last is None or time - last[0] > 0.03:
        return time, (pitch, yaw), None
    rates = [(new - old) / (time - last[0]) for new, old in zip((pitch, yaw), last[1], strict=True)]
    assert max(map(abs, rates)) <= 120.0 + 1e-6
    if last[2] is not None:
        assert max(abs(new - old) for new, old in zip(rates, last[2], strict=True)) <= 600.0 * (time - last[0]) + 1e-6
    return time, (pitch, yaw), rates


def test_no_history_points_wrongly():
    """3,000 random histories: within angle, rate and acceleration, still 0.3 s after staleness, and it recovers."""
    rng, pointed = np.random.default_rng(11), 0
    for number in range(3_000):
        chance, last = Chance(rng, 30), None
        for stale, sent in chance.run():
            for time, command in sent:
                last = check(stale, time, command, last)
                pointed += last is not None
        if number % 50 == 0:
            chance.bench.autopilot.acknowledges = True
            chance.bench.autopilot.change_mode(HOLD, 'the pilot')
            chance.bench.run(7.0, pan=0.4, tilt=0.1)
            assert chance.bench.looks == pytest.approx((math.degrees(0.4), math.degrees(0.1)), abs=0.1)
    assert pointed > 15_000
