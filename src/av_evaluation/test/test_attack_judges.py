"""The judges of the attack: each fault is found, and what is right is not called a fault."""

from __future__ import annotations

import math
import signal
import sys
import time

import pytest
from nav_msgs.msg import Odometry

from av_common.stamps import to_stamp
from av_evaluation.attack.judges import BearingCheck, CommandJudge, CommandLimits, Findings
from av_evaluation.cli.attack import IN_TIME, Result, verdicts
from av_evaluation.processes import MarkedProcesses, slowdown
from av_interfaces.msg import Bearing, PointingCommand
from av_pointing.settings import PointingSettings

START = 1000.0


@pytest.mark.parametrize(('fields', 'fault'), [
    ({'pan': math.nan}, 'pan is not finite'), ({'tilt_rate': math.inf}, 'tilt is not finite'),
    ({'tilt': 1.0}, 'tilt is out'), ({'yaw_rate': 0.9}, 'yaw is out'), ({'yaw_rate': 0.5}, 'yaw accelerates'), ({}, '')])
def test_limits_of_commands(fields, fault):
    limits = CommandLimits(PointingSettings())
    assert not limits.check(PointingCommand(), 1.0)
    found = limits.check(PointingCommand(**fields), 0.02)
    assert found.startswith(fault) and bool(found) == bool(fault)


def test_jitter_of_stamps_hides_no_lasting_acceleration():
    settings = PointingSettings()
    for factor in (1.0, 1.3):
        limits, rate, faults = CommandLimits(settings, 1e-9, jitter=0.03), 0.0, []
        for number in range(40):
            change = (0.02 if number < 20 else -0.02) * factor * settings.pan.acceleration
            rate = min(max(rate + change, -settings.pan.rate), settings.pan.rate)
            faults.append(limits.check(PointingCommand(pan_rate=rate), 0.02 + (0.01 if number % 2 else -0.01)))
        assert any(faults) == (factor > 1.0)


def judged(still_from: float = math.inf, ended: float = math.inf, move_body: bool = True) -> int:
    """Number of wrong motions among a second of commands."""
    judge = CommandJudge(PointingSettings())
    judge.begin(still_from)
    judge.end(ended)
    for number in range(50):
        judge.on_command(PointingCommand(move_body=move_body, yaw_rate=0.1), START + 0.02 * number)
    assert judge.findings.commands == 50
    return len(judge.findings.moves)


def test_motion_is_wrong_while_it_is_forbidden():
    assert judged() == judged(START, move_body=False) == 0
    assert judged(START + 0.5) == 25
    assert judged(START + 0.5, START + 0.7) == 10


def odometry(time: float, x: float) -> Odometry:
    message = Odometry()
    message.header.stamp, message.pose.pose.position.x = to_stamp(time), x
    return message


def test_tracking_is_back_after_half_a_second_of_true_bearings():
    check = BearingCheck()
    for number in range(40):
        now = START + 0.05 * number
        check.on_truth('rig', odometry(now, 0.0), now)
        check.on_truth('target', odometry(now, 10.0), now)
        bearing = Bearing(state=Bearing.STATE_VISUAL_ACTIVE, resolved=True, azimuth=0.5 if number < 16 else 0.02)
        bearing.header.stamp = to_stamp(now)
        check.on_bearing(bearing, now)
        check.judge(now)
    check.judge(START + 5.0)
    assert check.recovered(START + 0.3) == pytest.approx(0.5, abs=0.01)
    assert check.recovered(START + 1.8) is None
    assert check.faults(START, START + 5.0) == {'': 24, 'elsewhere': 16}
    assert check.azimuth == 0.0


def test_an_observer_that_is_behind_keeps_the_truth_since_the_attack():
    check = BearingCheck()
    for number in range(20):
        now = START + 0.05 * number
        check.on_truth('rig', odometry(now, 0.0), now)
        check.on_truth('target', odometry(now, 10.0 if number >= 10 else -10.0), now)   # a forged one before
        bearing = Bearing(state=Bearing.STATE_VISUAL_ACTIVE, resolved=True, azimuth=0.02)
        bearing.header.stamp = to_stamp(now)
        check.on_bearing(bearing, now)
    check.forget_truth(START + 0.475)    # told only now
    check.judge(START + 5.0)
    assert check.faults(START, START + 5.0) == {'': 10}


def test_verdicts_name_what_failed():
    good = Result('messages', recovery=0.5)
    assert not any(verdicts([good]).values())
    bad = Result('messages', recovery=2.5, deaths=['doa_node'], found=Findings(bad=['pan'], moves=['yaw']))
    assert all(verdicts([good, bad]).values())
    assert verdicts([Result('messages', recovery=None)])[IN_TIME]


def test_times_are_judged_by_what_the_machine_gave():
    """A rig whose threads wait three times as long as they run may take four times as long; one without other load may not."""
    before = {1: (1.0, 5.0), 2: (2.0, 0.0)}
    busy = slowdown(before, {1: (2.0, 8.0), 3: (1.0, 3.0)})    # 2 has ended, 3 is new
    assert busy == pytest.approx(4.0) and slowdown(before, before) == 1.0
    for slow, late in ((1.0, 1), (busy, 0)):
        result = Result('messages', recovery=3.9, slowdown=slow)
        assert len(result.late) == len(verdicts([result])[IN_TIME]) == late
    for recovery, late in ((4.9, 0), (5.1, 1)):
        assert len(Result('messages', recovery=recovery, slowdown=busy).late) == late


def test_run_times_are_those_of_the_system():
    """A program that computes has run; its threads are found."""
    one = MarkedProcesses([sys.executable, '-c', 'while True: pass'])
    try:
        while sum(ran for ran, _ in one.run_times().values()) < 0.05:
            time.sleep(0.01)
    finally:
        one.signal(signal.SIGKILL)
        one.process.wait()
