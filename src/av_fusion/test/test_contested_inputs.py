"""Inputs with two sources: what continues the track is used, counts as a prediction, and measures again with one source."""

from __future__ import annotations

import math
from random import Random

import numpy as np
import pytest
from test_fusion_stage import camera_info, detections, doa, make_stage, odometry

from av_common.angles import wrap
from av_common.single_source import CONTESTED_S, SingleSource
from av_common.stamps import to_seconds
from av_fusion.checkpoints import LEAST_AGE_S, Checkpoints
from av_fusion.contested_inputs import Copies
from av_fusion.filter.gating import Agreement
from av_fusion.measurement.input_gate import InputGate
from av_fusion.measurement.measurements import Detection, Hypothesis
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_interfaces.msg import Bearing

START, ATTACK, END, LAST = 1000.0, 1004.0, 1014.0, 1015.5   # s
TURN, YAW = math.radians(6.0), 0.3    # of the target, of the rig
VIEW = 0.58    # rad, half
OFFSETS = (0.0, 0.0, -0.1, 0.09, -0.5, -0.9)    # s, of forged stamps
DELAYS = {'doa': 0.3, 'detections': 0.1, 'odometry': 0.003}    # s, of genuine messages
FORGED = ('doa', 'detections', 'odometry')
PUNCTUAL, SPARSE = (0.003, 0.013, 0.023, 0.033), (0.0, 0.003, 0.01, 0.05, 0.3)    # s, delays of forged odometry
SPINS = [(seed, rate, age, 150.0, PUNCTUAL) for seed in (1, 4) for rate in (-40.0, 20.0, 35.0) for age in (0.1, 0.4)]
SPINS += [(seed, 20.0, 0.1, 60.0, SPARSE) for seed in (0, 2)]


def pixel(azimuth):
    return 319.5 - 457.0 * math.tan(azimuth)


def genuine(azimuth, random):
    """Arrival, input and arguments of the messages of a rig at rest and a target that circles."""
    for k in range(int((LAST - START) * 100)):
        yield START + 0.01 * k + DELAYS['odometry'], 'odometry', (START + 0.01 * k, YAW)
    for k in range(int((LAST - START) * 10)):
        stamp = START + 0.1 * k
        yield stamp + DELAYS['doa'], 'doa', (stamp, azimuth(stamp) + random.normal(0.0, 0.02))
    for k in range(int((LAST - START) * 15)):
        stamp = START + k / 15
        seen = azimuth(stamp) + random.normal(0.0, 0.005)
        yield stamp + DELAYS['detections'], 'detections', (stamp, *([(pixel(seen), 0.9, 'drone')] if abs(seen) < VIEW else []))


def forged(names, random, rate=60.0):
    """The same of plausible falsehoods: a target ahead, a rig that has turned."""
    for k in range(int((END - ATTACK) * rate)):
        now = ATTACK + k / rate
        made = {'doa': (0.02,), 'detections': ((309.0, 0.86, 'drone'),), 'odometry': (random.choice((0.25, 1.0, -2.0)),)}
        for name in names:
            yield now, name, (now + random.choice(OFFSETS), *made[name])


def punctual(names, random, rate=60.0):
    """Falsehoods from anywhere, with the delays of genuine messages."""
    for k in range(int((END - ATTACK) * rate)):
        now = ATTACK + k / rate
        made = {'doa': (random.uniform(-1.5, 1.5),), 'detections': ((random.uniform(0.0, 640.0), 0.86, 'drone'),),
                'odometry': (random.uniform(-math.pi, math.pi),)}
        for name in names:
            yield now, name, (now - DELAYS[name] + random.gauss(0.0, 0.03), *made[name])


def ahead(names, random, rate=60.0):
    """Old measurements with new stamps: the drone where it was when the attack began."""
    start = math.radians(random.start)
    for k in range(int((END - ATTACK) * rate)):
        now = ATTACK + k / rate
        made = {'doa': (start,), 'detections': ((pixel(start), 0.86, 'drone'),), 'odometry': (YAW,)}
        for name in names:
            yield now, name, (now + random.choice((0.0, 0.05, -0.05, -0.1, -0.3, -0.35)), *made[name])


def run(names, start, seed=0, attack=forged, **values):
    """The stage; time, output and true azimuth of each output; the target is at `start` (deg) when the attack begins."""
    stage, make = make_stage(**values), {'doa': doa, 'detections': detections, 'odometry': odometry}
    stage.on_camera_info(camera_info())

    def azimuth(time):
        return wrap(math.radians(start) + TURN * (time - ATTACK))
    random = Random(seed)
    random.start = start
    messages = [*genuine(azimuth, np.random.default_rng(seed)), *attack(names, random)]
    outputs = []
    for now, name, (stamp, *rest) in sorted(messages, key=lambda message: message[0]):
        output = getattr(stage, f'on_{name}')(make[name](stamp, *rest), now) or stage.on_time(now)
        if output is not None:
            outputs.append((now, output, azimuth(now)))
    return stage, outputs


def is_true(output, azimuth):
    bearing = output.bearing
    return bearing.state != Bearing.STATE_NONE and bearing.resolved and abs(wrap(bearing.azimuth - azimuth)) < math.radians(5.0)


@pytest.mark.parametrize(('attack', 'share'), [(forged, 0.98), (punctual, 0.9), (ahead, 0.98)])
@pytest.mark.parametrize('start', [-28.0, -12.0, 5.0, 15.0])    # seen at the end of the attack, or only heard
def test_falsehoods_are_not_followed_and_tracking_goes_on(start, attack, share):
    stage, outputs = run(FORGED, start, seed=2, attack=attack)
    contest = [(output, azimuth) for now, output, azimuth in outputs if ATTACK + 0.6 < now < END]
    assert not any(output.bearing.source for output, _ in contest)    # nothing moves: it counts as a prediction
    assert all(to_seconds(output.bearing.measured) < ATTACK + 0.6 for output, _ in contest)
    assert not any(track.source for output, _ in contest for track in output.targets.tracks)
    assert np.mean([is_true(output, azimuth) for output, azimuth in contest]) > share
    late = [(is_true(output, azimuth), output.bearing.source) for now, output, azimuth in outputs if now > END + 0.5]
    assert len(late) > 10 and all(true and source for true, source in late)
    assert all(count > 0 for count in stage.gate.sources.refused.values())


def test_a_track_that_was_drawn_away_ends_with_the_attack():
    """Many forged messages, which begin at the drone and leave it slowly, are followed; afterwards it is seen at once."""
    def slow(names, random):
        for k in range(int((END - ATTACK) * 200)):
            now = ATTACK + k / 200
            place = math.radians(-40.0 - 3.0 * (now - ATTACK))
            made = {'doa': (place,), 'detections': ((pixel(place), 0.86, 'drone'),)}
            for name in names:
                yield now, name, (now - DELAYS[name] + random.choice((-0.03, 0.0, 0.03)), *made[name])
    _, outputs = run(('doa', 'detections'), -40.0, attack=slow)
    assert all(is_true(output, azimuth) for now, output, azimuth in outputs if now > END + 0.7)


@pytest.mark.parametrize(('seed', 'rate', 'age', 'frequency', 'delays'), SPINS)
def test_old_attitudes_with_new_stamps_do_not_turn_the_rig(seed, rate, age, frequency, delays):
    """A rig that turns and stops, and copies of its attitude of some time before the attack."""
    stage, random, rate = make_stage(), Random(seed), math.radians(rate)

    def yaw(time):
        return rate * min(time - ATTACK, 0.4)
    messages = [(stamp + DELAYS['odometry'], (stamp, yaw(stamp), rate * (stamp < ATTACK + 0.4)))
                for stamp in np.arange(START, END, 0.01).tolist()]
    messages += [(now, (now - random.choice(delays), yaw(ATTACK - age), rate))
                 for now in np.arange(ATTACK, END, 1.0 / frequency).tolist()]
    errors = []
    for now, message in sorted(messages):
        stage.on_odometry(odometry(*message), now)
        stage.on_time(now)
        errors.append(abs(wrap(stage.tracker.motion.yaw(now) - yaw(now))) if now > ATTACK + 1.0 else 0.0)
    assert np.mean(errors) < math.radians(1.0)


@pytest.mark.parametrize('name', FORGED)
def test_one_contested_input_leaves_the_track_to_the_others(name):
    stage, outputs = run([name], -20.0)
    assert np.mean([is_true(output, azimuth) for now, output, azimuth in outputs if now > ATTACK]) > 0.95
    assert [other for other, count in stage.gate.sources.refused.items() if count] == [name]
    assert all(output.state.missing == [name] for now, output, _ in outputs if ATTACK + 1.5 < now < END)


def test_a_source_alone_is_used_whatever_its_period():
    source = SingleSource()
    stamps = np.cumsum(np.random.default_rng(0).exponential(0.05, 500))
    last = stamps[-1]    # twice the same at the end, and a corrected clock
    assert all(source.take(stamp, last + 0.2) for stamp in (*stamps, last, last - 0.005))
    assert source.refused == 0


def test_two_sources_are_refused_until_one_ends():
    source = SingleSource()
    assert source.take(10.0, 10.1)
    assert source.take(10.3, 10.3)    # nothing tells that it is another's
    assert not source.take(10.2, 10.35)
    assert not source.take(10.4, 10.5)
    assert source.take(10.5, 10.35 + CONTESTED_S)
    assert source.refused == 2


def test_impossible_stamps_prolong_a_contest_and_start_none():
    """An intruder whose stamps are plausible now and then has no turn of its own between the genuine messages."""
    gate = InputGate(['doa'], tolerance=5.0)
    accepted = []
    for step in range(400):
        now = 100.0 + 0.05 * step
        accepted.append(gate.accept('doa', now - 0.06, now))
        gate.accept('doa', now + 1e6, now + 0.01)
        if step >= 200 and step % 8 == 0:    # 0.4 s apart, longer than a contest
            assert not gate.accept('doa', now + 0.02, now + 0.02) or step == 200
    assert all(accepted[:201])
    assert not any(accepted[201:])


def test_messages_are_punctual_by_the_delays_of_the_source_that_was_alone():
    source = SingleSource()
    assert not source.is_punctual(0.0, 0.3)    # nothing is known of it
    for k in range(40):
        assert source.take(0.1 * k, 0.1 * k + 0.25 + 0.01 * (k % 6))    # 0.25 to 0.3 s
    assert all(source.is_punctual(5.0, 5.0 + delay) for delay in (0.245, 0.27, 0.58))
    assert not any(source.is_punctual(5.0, 5.0 + delay) for delay in (-0.1, 0.0, 0.23, 0.62))


def test_copies_are_recognised_on_a_camera_that_turns():
    random, copies = np.random.default_rng(3), Copies()
    pan = [((math.cos(a), -math.sin(a), 0.0), (math.sin(a), math.cos(a), 0.0), (0.0, 0.0, 1.0)) for a in (0.1, 0.7)]
    for _ in range(50):
        azimuth, elevation = random.normal(0.0, 0.3, 2)
        first, again = (Detection(azimuth + angle, 1e-4, 0.9, elevation) for angle in (0.1, 0.7))
        assert copies.among([[first]], pan[0]) == [False]
        assert copies.among([[again], [first]], pan[1]) == [True, False]


def test_measurements_that_contradict_each_other_do_not_agree():
    def at(*degrees):
        return [Hypothesis(math.radians(angle), math.radians(1.0)**2) for angle in degrees]
    agreement = Agreement()
    assert agreement.add(10.0, at(20.0))
    assert agreement.add(10.1, at(24.0, 156.0))    # within three standard deviations of both, as one of its images
    assert not agreement.add(10.2, at(30.0))
    assert not agreement.add(10.3, at(20.0))    # which of the two is false nobody knows
    assert agreement.add(10.7, at(-90.0))    # forgotten


def test_a_pose_continues_what_the_last_one_and_its_rates_predict():
    motion, rate = RigMotion(), math.radians(40.0)
    for k in range(50):
        motion.add(Pose.level(0.02 * k, rate * 0.02 * k, rate))
    expected = rate * 1.0
    assert motion.continues(Pose.level(1.0, expected, rate))
    assert motion.continues(Pose.level(1.0, expected + math.radians(0.5), rate + 0.4))
    assert not motion.continues(Pose.level(1.0, expected + math.radians(2.0), rate))
    assert not motion.continues(Pose.level(1.0, expected, -rate))
    assert not motion.continues(Pose.level(0.98, rate * 0.98, rate))    # not later
    assert not motion.continues(Pose.level(3.0, rate * 3.0, rate))    # nothing is known after so long
    assert not motion.continues(Pose(1.0, (math.nan, 0.0, 0.0, 0.0)))
    assert not RigMotion().continues(Pose.level(1.0, 0.0))


def test_a_clock_that_starts_again_is_no_second_source():
    source = SingleSource()
    assert source.take(50.0, 50.1)
    assert source.take(3.0, 3.1)


@pytest.mark.parametrize('method', ['bayes', 'gated'])
def test_checkpoints_return_to_a_recent_state(method):
    checkpoints, tracker = Checkpoints(), make_stage(method=method).tracker
    assert checkpoints.before(START) is None
    checkpoints.keep((tracker,), START)
    assert checkpoints.before(START + 0.5 * LEAST_AGE_S) is None    # it may have used the second source already
    assert [type(copy) for copy in checkpoints.before(START + 0.3)] == [type(tracker)]
    assert checkpoints.before(START + 10.0) is None    # prediction from so long ago tells nothing
