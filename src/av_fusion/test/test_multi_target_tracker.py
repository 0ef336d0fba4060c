"""The tracker of several targets: which one is followed, ids, disambiguation, messages."""

from __future__ import annotations

import math

import pytest
from simulated_sensors import SimulatedSensors

from av_common.parameters import node_parameters
from av_common.track import State, Target, Track
from av_common.track_messages import targets_message
from av_fusion.identity.selection import Selection
from av_fusion.measurement.measurements import CameraMeasurement, Cone, Detection, DoaMeasurement, Hypothesis
from av_fusion.measurement.rig_motion import Pose
from av_fusion.settings import make_tracker
from av_fusion.tracker import MultiTargetTracker, TrackerSettings

SIGMA = math.radians(0.4)


def image(time, *targets):
    """An image of targets as (azimuth, score)."""
    return CameraMeasurement(time, tuple(Detection(azimuth, SIGMA**2, score, 0.1, SIGMA**2) for azimuth, score in targets),
                             visibility=1.0)


def see(tracker, targets, seconds=2.0, start=100.0):
    """Show the same image ten times a second; the last estimate and its targets."""
    for step in range(int(10 * seconds)):
        time = start + 0.1 * step
        tracker.add_pose(Pose.level(time, 0.0))
        tracker.add_camera(image(time, *targets))
        track = tracker.estimate(time)
    return track, tracker.targets(track)


def test_the_most_central_target_is_followed_and_a_selected_one_instead():
    """Policy `centre`, then `select`, then the policy again; an unknown id is refused."""
    tracker = MultiTargetTracker(TrackerSettings(policy='centre'))
    track, targets = see(tracker, [(0.05, 0.9), (0.4, 0.9)])
    assert len(targets.targets) == 2 and abs(track.azimuth - 0.05) < 0.02
    other = next(target.id for target in targets.targets if target.id != targets.selected)
    tracker.select(other)
    track, targets = see(tracker, [(0.05, 0.9), (0.4, 0.9)], 0.2, 102.0)
    assert targets.selected == other and abs(track.azimuth - 0.4) < 0.02
    tracker.select(0)
    track, _ = see(tracker, [(0.05, 0.9), (0.4, 0.9)], 1.0, 102.2)
    assert abs(track.azimuth - 0.05) < 0.02
    with pytest.raises(ValueError, match='target 99 is not tracked'):
        tracker.select(99)


def test_a_bird_is_tracked_but_not_followed():
    """Scores of 0.35 that persist: a target that exists, and is no drone."""
    track, targets = see(MultiTargetTracker(), [(0.1, 0.35)], 3.0)
    bird, = targets.targets
    assert bird.existence > 0.9 and bird.drone_probability < 0.5
    assert track.state == State.NONE and targets.selected == 0


def test_a_bystander_is_tracked_but_not_followed():
    """Two sounds, of which one is judged to be no drone: both have tracks, the drone is followed throughout."""
    tracker, sensors = MultiTargetTracker(), SimulatedSensors(3)
    for step in range(40):
        time = 100.0 + 0.1 * step
        tracker.add_pose(Pose.level(time, 0.0))
        tracker.add_doas([sensors.doa(time, 0.9)._replace(drone_probability=0.02),
                          sensors.doa(time, -0.3)._replace(drone_probability=0.9)])
        track = tracker.estimate(time)
        if step > 10:
            assert min(abs(track.azimuth + 0.3), abs(abs(track.azimuth) - (math.pi - 0.3))) < 0.15
    kinds = [target.drone_probability > 0.5 for target in tracker.targets(track).targets]
    assert sorted(kinds) == [False, True]


def test_a_drone_at_end_fire_that_is_masked_for_long_is_a_few_components():
    """Each window shows something else only, beside the axis: the track is compared with it, but not updated."""
    tracker = MultiTargetTracker()
    for k in range(60):
        time, masked = 100.0 + 0.1 * k, k >= 20
        sound = DoaMeasurement.of_cone(time, Cone((0.0, 1.0, 0.0), 0.2 if masked else 0.97, 0.001), 0.9)
        tracker.add_pose(Pose(time, (1.0, 0.0, 0.0, 0.0)))
        tracker.add_doas([sound._replace(drone_probability=0.02 if masked else 0.98)])
        tracker.estimate(time)
        assert sum(len(track.mixture.components) for track in tracker.filter.tracks) < 50


def test_a_clearly_more_urgent_target_is_followed():
    """By half more, so that a choice between equal ones is kept."""
    selection = Selection('centre', 0.5)

    def targets(first, second):
        return [Target(name, 1.0, Track(0.0, azimuth=azimuth)) for name, azimuth in ((1, first), (2, second))]

    assert selection.choose(targets(0.1, 0.5)) == 1
    assert selection.choose(targets(0.13, 0.1)) == 1
    assert selection.choose(targets(0.5, 0.1)) == 2
    assert selection.choose(targets(0.1, 0.13)) == 2
    assert selection.choose([]) == 0


def test_of_two_targets_the_likelier_drone_is_followed_unless_one_is_wanted():
    """Both are heard alike; what is less likely a drone than the threshold is not followed at all."""
    def targets(first, second):
        return [Target(1, 1.0, Track(0.0, azimuth=0.1), drone_probability=first),
                Target(2, 1.0, Track(0.0, azimuth=0.12), drone_probability=second)]

    selection = Selection('centre', 0.5)
    assert selection.choose(targets(0.6, 0.4)) == 1
    assert selection.choose(targets(0.6, 0.65)) == 1
    assert selection.choose(targets(0.6, 0.9)) == 2
    assert selection.choose(targets(0.4, 0.45)) == 0
    selection.wanted = 1
    assert selection.choose(targets(0.4, 0.95)) == 1


def test_what_may_be_behind_is_worth_less_than_what_is_as_certainly_ahead():
    """The variance of a track is that of one side, which an open one has with its probability only."""
    def target(name, sigma, **side):
        return Target(name, 1.0, Track(0.0, azimuth=0.1, covariance_world=(sigma**2, 0.0, 0.0, sigma**2), **side))

    selection = Selection('certain', 0.5)
    assert selection.choose([target(1, 0.02, front_probability=0.4), target(2, 0.025, resolved=True)]) == 2
    assert selection.choose([target(1, 0.005, front_probability=0.1), target(2, 0.025, resolved=True)]) == 1


def test_nothing_is_tracked_without_measurements_and_after_a_gap():
    """No target before the first measurement, and none 6 s after the newest."""
    tracker = MultiTargetTracker()
    assert tracker.estimate(100.0).state == State.NONE
    track, targets = see(tracker, [(0.1, 0.9)])
    assert track.state == State.VISUAL_ACTIVE and track.measured == track.time
    later = tracker.estimate(track.time + 6.0)
    assert later.state == State.NONE and tracker.targets(later).targets == ()
    _, again = see(tracker, [(0.1, 0.9)], 1.0, 120.0)
    assert again.targets[0].id > targets.targets[0].id


def test_message_of_targets():
    """What it carries, with the stamp of the estimate."""
    track, targets = see(MultiTargetTracker(), [(0.1, 0.9), (-0.3, 0.9)])
    message = targets_message(targets, 'base_link')
    assert [one.id for one in message.tracks] == [1, 2] and message.selected == targets.selected
    assert message.header.frame_id == 'base_link' and message.header.stamp.sec == int(track.time)
    for one in message.tracks:
        assert 0.0 <= one.existence <= 1.0 and one.drone_probability > 0.5 and one.class_id == 'drone'
        assert one.last_seen.sec + 1e-9 * one.last_seen.nanosec == pytest.approx(track.time) and one.last_heard.sec == 0


def test_parameters_choose_the_tracker():
    """That of several targets is the default; its policy."""
    values = {'policy': 'closing'}
    tracker = make_tracker(node_parameters('av_fusion', 'fusion_node', overrides=values))
    assert isinstance(tracker, MultiTargetTracker) and tracker.settings.policy == 'closing'


def test_who_is_wanted_is_followed_at_once():
    """Of two that are heard and that nothing judges, the second one is new: by itself it would be waited for."""
    tracker, wanted = MultiTargetTracker(), 0
    for step in range(30):
        time, azimuths = 100.0 + 0.1 * step, (0.3, -1.5)[:1 + (step >= 12)]
        tracker.add_doas([DoaMeasurement(time, (Hypothesis(azimuth, 1e-3, 0.1, 1e-3),), 0.95, 0.1) for azimuth in azimuths])
        targets = tracker.targets(tracker.estimate(time))
        if not wanted and len(targets.targets) == 2:
            assert targets.selected == 1
            wanted = targets.targets[1].id
            tracker.select(wanted)
        else:
            assert targets.selected == (wanted or targets.selected)
    assert wanted


def test_that_nothing_is_judged_yet_is_said_so():
    """Two new targets, of which nothing tells what they are."""
    tracker, reasons = MultiTargetTracker(), set()
    for step in range(8):
        time = 100.0 + 0.1 * step
        tracker.add_doas([DoaMeasurement(time, (Hypothesis(azimuth, 1e-3, 0.1, 1e-3),), 0.95, 0.1) for azimuth in (0.3, -1.5)])
        track = tracker.estimate(time)
        reasons |= {track.reason} if len(tracker.targets(track).targets) == 2 else set()
    assert len(reasons) == 1 and 'not judged yet' in reasons.pop()


def test_a_loud_source_where_both_images_meet_resolves_no_other_target():
    """An array in an upright plane: images of what is beside it are one direction, those of the other target are not."""
    tracker, resolved = MultiTargetTracker(), []
    for step in range(40):
        time = 100.0 + 0.1 * step
        found = [DoaMeasurement(time, tuple(Hypothesis(math.remainder(one, math.tau), math.radians(2.0)**2, 0.1, 1e-3)
                                            for one in (azimuth, math.pi - azimuth)), 0.95, 0.1, drone_probability=0.9)
                 for azimuth in (math.radians(89.0), 0.5)[step < 25:]]
        tracker.add_doas(found)
        track = tracker.estimate(time)
        resolved += [target.track.resolved for target in tracker.targets(track).targets if target.id == 1]
    assert len(resolved) > 30 and not any(resolved)
