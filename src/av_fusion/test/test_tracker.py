"""The Bayes filter against targets whose path is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated_sensors import SimulatedSensors

from av_common.angles import wrap
from av_common.parameters import node_parameters
from av_common.track import Source, State
from av_fusion.disambiguation.rotation import ASKED_S, RotationPlanner
from av_fusion.gated_tracker import GatedTracker
from av_fusion.measurement.measurements import (
    CameraMeasurement,
    Cone,
    Detection,
    DoaMeasurement,
    Hypothesis,
    usable_camera,
    usable_doa,
)
from av_fusion.measurement.rig_motion import Pose
from av_fusion.plain_tracker import PlainTracker
from av_fusion.tracker import MultiTargetTracker, TrackerSettings
from av_fusion.tracks.settings import FilterSettings

TURN_RATE = math.radians(40.0)


def run(tracker, sensors, azimuth_world, yaw, seconds, doa=True, visibility=0.0, obey=False):
    """Feed 20 directions and 15 images a second; returns times, tracks and body azimuths of the truth."""
    times, tracks, truths, heading = [], [], [], yaw(0.0) if callable(yaw) else yaw
    for step in range(int(seconds * 60)):
        t = 100.0 + step / 60.0
        if callable(yaw):
            heading = yaw(t - 100.0)
        elif obey and tracks:
            wanted = tracks[-1].requested_rotation
            heading += float(np.clip(wanted, -TURN_RATE / 60.0, TURN_RATE / 60.0))
        tracker.add_pose(Pose.level(t, float(wrap(heading))))
        body = float(wrap(azimuth_world(t - 100.0) - heading))
        if doa and step % 3 == 0:
            tracker.add_doas([sensors.doa(t, body)])
        if step % 4 == 0:
            tracker.add_camera(sensors.camera(t, body, visibility))
        times.append(t - 100.0)
        tracks.append(tracker.estimate(t))
        truths.append(body)
    return np.array(times), tracks, np.array(truths)


def errors_deg(tracks, truths, start):
    """Errors of the bearing from sample `start` on."""
    return np.degrees([wrap(track.azimuth - truth) for track, truth in zip(tracks[start:], truths[start:], strict=True)])


@pytest.mark.parametrize('azimuth_deg', [10, 60, 100, 135, 175, -20, -80, -110, -170])
def test_a_requested_rotation_resolves_front_and_back(azimuth_deg):
    """Obeying the requested rotation resolves the hemisphere within 5 s, to the right side."""
    tracker = MultiTargetTracker()
    times, tracks, truths = run(tracker, SimulatedSensors(azimuth_deg), lambda t: math.radians(azimuth_deg), 0.0, 6.0,
                                obey=True)
    resolved = [k for k, track in enumerate(tracks) if track.resolved]
    assert resolved and times[resolved[0]] < 5.0
    assert abs(wrap(tracks[resolved[0]].azimuth - truths[resolved[0]])) < math.radians(15)
    bound = max(math.radians(5.0), 1.5 * math.sqrt(tracks[-1].azimuth_variance))  # close to end-fire elevation matters
    assert tracks[-1].resolved and abs(wrap(tracks[-1].azimuth - truths[-1])) < bound


def test_gated_resolves_by_fixed_rotation():
    """The published way works too, in its own time."""
    tracker = GatedTracker()
    _, tracks, truths = run(tracker, SimulatedSensors(3), lambda t: math.radians(150), 0.0, 6.0, obey=True)
    assert tracks[-1].resolved and abs(wrap(tracks[-1].azimuth - truths[-1])) < math.radians(8)


def test_sight_resolves_and_sharpens():
    """One image of a target in view resolves the hemisphere, and the error is that of the camera."""
    _, tracks, truths = run(MultiTargetTracker(), SimulatedSensors(4), lambda t: math.radians(20), 0.0, 3.0, visibility=1.0)
    assert tracks[-1].state == State.VISUAL_ACTIVE and tracks[-1].resolved
    assert np.sqrt(np.mean(errors_deg(tracks, truths, 60) ** 2)) < 0.4
    assert tracks[-1].source == Source.SIGHT | Source.SOUND


def test_tracks_a_moving_target_from_a_turning_rig():
    """By sound, a target at 15 deg/s past end-fire of a rig turning at 30: the yaw of each measurement's time counts."""
    found, rate = [], math.radians(15)
    for seed in range(8, 13):
        _, tracks, truths = run(MultiTargetTracker(), SimulatedSensors(seed), lambda t: rate * t, lambda t: 2.0 * rate * t,
                                12.0)
        folded = [math.asin(math.sin(track.azimuth)) - math.asin(math.sin(truth))  # nothing tells the hemisphere here
                  for track, truth in zip(tracks[480:], truths[480:], strict=True)]
        found.append(math.degrees(float(np.sqrt(np.mean(np.square(folded))))))
    assert max(found) < 2.0


def test_late_measurements_count_at_their_own_time():
    """Sound that comes 0.4 s late gives the same bearing as sound in time, within the noise."""
    rate = math.radians(12)
    prompt, late = MultiTargetTracker(), MultiTargetTracker()
    sensors = SimulatedSensors(9)
    pending = []
    for step in range(400):
        t = 100.0 + step / 20.0
        measurement = sensors.doa(t, float(wrap(rate * (t - 100.0))))
        prompt.add_doas([measurement])
        pending.append(measurement)
        if len(pending) > 8:
            late.add_doas([pending.pop(0)])
        for tracker in (prompt, late):
            tracker.add_camera(sensors.camera(t, 3.0, 0.0))
    truth = rate * 400 / 20.0
    for tracker in (late, prompt):  # folded to the front: nothing tells the hemisphere here
        assert abs(math.asin(math.sin(tracker.estimate(120.0).azimuth)) - math.asin(math.sin(truth))) < math.radians(4)


def test_silence_widens_and_ends_the_track_and_return_starts_it_again():
    """No bearing is invented: variance grows, coasting is said, then the track ends; sound brings it back."""
    tracker, sensors = MultiTargetTracker(), SimulatedSensors(10)
    run(tracker, sensors, lambda t: 0.3, 0.0, 3.0, visibility=1.0)
    soon, later, end = (tracker.estimate(103.0 + dt) for dt in (0.5, 2.0, 20.0))
    assert later.state == State.COASTING and later.azimuth_variance > soon.azimuth_variance
    assert end.state == State.NONE and math.isnan(end.azimuth)
    for k in range(20):
        tracker.add_doas([sensors.doa(130.0 + 0.05 * k, 0.3)])
    assert tracker.estimate(131.0).state == State.ACOUSTIC_ACTIVE


def test_garbage_is_no_measurement():
    """NaN, infinite and empty measurements."""
    nan, good = math.nan, Hypothesis(0.1, 0.1)
    for measurement in (DoaMeasurement(nan, (good,), 0.9), DoaMeasurement(103.0, (Hypothesis(nan, 0.1),), 0.9),
                        DoaMeasurement(103.0, (), 0.9), DoaMeasurement(103.0, (good,), nan)):
        assert usable_doa(measurement) is None
    assert usable_doa(DoaMeasurement(103.0, (good, Hypothesis(nan, 0.1)), 0.9)).hypotheses == (good,)
    assert usable_camera(CameraMeasurement(nan, ())) is None and usable_camera(CameraMeasurement(1.0, (), nan)) is None
    assert usable_camera(CameraMeasurement(1.0, (Detection(nan, 1e-4, 0.9), Detection(0.1, 1e-4, nan)))).detections == ()


@pytest.mark.parametrize('seed', range(4))
def test_images_in_fog_never_flip_a_correct_hemisphere(seed):
    """Half a minute of images without detections, where almost nothing can be seen, leaves front in front."""
    tracker, sensors = MultiTargetTracker(), SimulatedSensors(seed)
    run(tracker, sensors, lambda t: 0.3, 0.0, 2.0, visibility=1.0)
    path = lambda t: 0.3 + 0.2 * math.sin(0.4 * t)  # noqa: E731
    for step in range(30 * 10):
        t = 102.0 + step / 10.0
        tracker.add_doas([sensors.doa(t, path(t))])
        tracker.add_camera(sensors.camera(t, 3.0, 0.02))
        track = tracker.estimate(t)
        assert track.front_probability > 0.95 and track.resolved


@pytest.mark.parametrize('seed', range(3))
def test_a_second_drone_does_not_break_the_track(seed):
    """A second drone with equal scores is left alone: the one nearest in the posterior is followed."""
    tracker, sensors = MultiTargetTracker(), SimulatedSensors(seed)
    first, second = (lambda t: 0.1 * t), (lambda t: 0.55 - 0.05 * t)
    errors = []
    for step in range(8 * 20):
        t = step / 20.0
        tracker.add_doas([sensors.doa(100.0 + t, first(t) if t < 2.0 or step % 4 else second(t))])
        looks = [sensors.camera(100.0 + t, path(t)) for path in ([first] if t < 2.0 else [first, second])]
        tracker.add_camera(looks[0]._replace(detections=tuple(d for camera in looks for d in camera.detections)))
        track = tracker.estimate(100.0 + t)
        errors.append(min(abs(track.azimuth - first(t)), abs(track.azimuth - second(t))))
        if t < 3.0:
            assert t < 0.5 or abs(track.azimuth - first(t)) < math.radians(3)
    assert math.degrees(float(np.sqrt(np.mean(np.square(errors[20:]))))) < 2.0


def test_order_of_arrival_hardly_matters():
    """Images that arrive 0.2 s late among directions: within 0.3 sigma of those in order, sigma within a factor of 1.6."""
    for seed in range(3):
        sensors, messages = SimulatedSensors(seed), []
        for step in range(120):
            t = 100.0 + step / 20.0
            azimuth = 0.2 + 0.05 * step / 20.0
            messages.append((t, sensors.doa(t, azimuth)))
            if step % 2:
                messages.append((t + 0.2, sensors.camera(t, azimuth)))
        in_order, as_arrived = MultiTargetTracker(), MultiTargetTracker()
        for tracker, key in ((in_order, lambda m: m[1].time), (as_arrived, lambda m: m[0])):
            for _, message in sorted(messages, key=key):
                tracker.add_doas([message]) if isinstance(message, DoaMeasurement) else tracker.add_camera(message)
        one, other = in_order.estimate(106.3), as_arrived.estimate(106.3)
        assert abs(one.azimuth - other.azimuth) < 0.3 * math.sqrt(one.azimuth_variance)
        assert 0.4 < other.azimuth_variance / one.azimuth_variance < 2.5


@pytest.mark.parametrize('seed', range(3))
def test_persistent_reflections_do_not_take_over_a_detected_target(seed):
    """Detections for 2 s of 4, all directions from 60 degrees: another target, not followed from 0.5 s in view on."""
    tracker, sensors, tracked = MultiTargetTracker(), SimulatedSensors(seed, math.radians(2.0)), []
    for step in range(30 * 20):
        t = 100.0 + step / 20.0
        if step % 80 < 40:
            tracker.add_camera(sensors.camera(t, -0.2))
        tracker.add_doas([sensors.doa(t - 0.25, math.radians(60.0))])
        track = tracker.estimate(t)
        if t > 110.0 and 10 < step % 80 < 45:
            tracked.append(track.state == State.VISUAL_ACTIVE and abs(track.azimuth + 0.2) < math.radians(5.0))
    assert np.mean(tracked) > 0.8


@pytest.mark.parametrize('rate', [6.0, 9.0])
@pytest.mark.parametrize('seed', range(3))
def test_steady_motion_continues_past_end_fire(seed, rate):
    """Around a rig that stands still, in view in front only: after a minute the side is right mostly, else it is not resolved.

    The target might have manoeuvred where neither sensor tells front from back, so that no filter can be certain.
    """
    tracker, sensors, errors, resolved = MultiTargetTracker(), SimulatedSensors(seed, math.radians(1.0)), [], []
    for step in range(120 * 20):
        t = step / 20.0
        body = float(wrap(math.radians(rate * t)))
        tracker.add_camera(sensors.camera(100.0 + t, body))
        tracker.add_doas([sensors.doa(100.0 + t, body)])
        track = tracker.estimate(100.0 + t)
        errors.append(abs(math.degrees(wrap(track.azimuth - body))))
        resolved.append(track.resolved)
    late, known = np.array(errors[60 * 20:]), np.array(resolved[60 * 20:])
    assert np.median(late) < 1.0 and np.mean(late < 30.0) > 0.75
    assert not np.any(known & (late > 30.0))


def test_a_detection_is_the_target_with_its_score():
    """Weak detections after empty images begin nothing that is reported; some that are more likely true than false do."""
    tracker = MultiTargetTracker()
    for step, confidence in enumerate([0.0] * 20 + [0.05, 0.1, 0.2] + [0.8] * 6):
        detections = (Detection(0.2, 1e-4, confidence),) if confidence else ()
        tracker.add_camera(CameraMeasurement(100.0 + step / 15.0, detections, visibility=1.0))
        track = tracker.estimate(100.0 + step / 15.0)
        assert track.state == State.NONE or confidence == 0.8
    assert track.state == State.VISUAL_ACTIVE


def test_without_detections_either_side_of_end_fire_stays_open():
    """A rig that stands still and never detects the target leaves the hemisphere open."""
    tracker, sensors = MultiTargetTracker(), SimulatedSensors(1)
    for step in range(24 * 20):
        t = step / 20.0
        tracker.add_doas([sensors.doa(100.0 + t, math.radians(-20.0 + 9.0 * t))])
        track = tracker.estimate(100.0 + t)
        assert not track.resolved or abs(math.degrees(track.azimuth)) > 75.0


def test_a_rotation_can_be_asked_for_while_front_and_back_are_open():
    """There is nothing to ask for before and afterwards."""
    tracker, asked = MultiTargetTracker(), []
    with pytest.raises(ValueError, match='would not help'):
        tracker.planner.ask(100.0)

    def azimuth(time):
        if time >= 0.2 and not asked:
            tracker.planner.ask(100.0 + time)
            asked.append(time)
        return math.radians(150)

    _, tracks, truths = run(tracker, SimulatedSensors(1), azimuth, 0.0, 5.0, obey=True)
    assert asked and tracks[-1].resolved and abs(wrap(tracks[-1].azimuth - truths[-1])) < math.radians(10)
    with pytest.raises(ValueError, match='would not help'):
        tracker.planner.ask(105.0)


def test_a_rotation_that_is_asked_for_ends_by_itself():
    tracker, sensors = MultiTargetTracker(), SimulatedSensors(1)
    tracker.add_doas([sensors.doa(10.0, 1.0)])
    assert tracker.estimate(10.0).requested_rotation != 0.0
    tracker.planner.ask(10.1)
    assert tracker.planner.is_asked(10.1 + ASKED_S - 0.1) and not tracker.planner.is_asked(10.1 + ASKED_S + 0.2)
    assert not tracker.planner.is_asked(10.0)  # the clock went back


@pytest.mark.parametrize('visibility', [math.nan, 1.0])
@pytest.mark.parametrize('azimuth_deg', [-105.0, -85.0, -75.0])
def test_a_rotation_brings_a_direction_into_view_although_no_visibility_is_stated(azimuth_deg, visibility):
    """Directions far to the right come into view by a turn to the right, whatever is known of the visibility."""
    tracker, sensors = MultiTargetTracker(), SimulatedSensors(1)
    for time in 100.0 + 0.25 * np.arange(4):
        tracker.add_camera(CameraMeasurement(time, (), math.radians(35.0), visibility=visibility))
        tracker.add_doas([sensors.doa(time, math.radians(azimuth_deg))])
    assert tracker.estimate(time).requested_rotation < 0.0


def test_where_rotations_are_not_enabled_none_can_be_asked_for():
    planner = RotationPlanner(enabled=False)
    with pytest.raises(ValueError, match='`rotation` is false'):
        planner.ask(10.0)


@pytest.mark.parametrize('make', [MultiTargetTracker, GatedTracker])
def test_other_thresholds_hold_from_now_on_and_the_track_stays(make):
    """A detection of 0.6 leads from tau 0.5 on and not from 0.7 on; nothing else changes."""
    tracker, sensors, states = make(), SimulatedSensors(3), []
    for step in range(120):
        if step == 60:
            tracker.tune(0.7, 0.99)
        t = 100.0 + step / 20.0
        tracker.add_camera(CameraMeasurement(t, (Detection(0.2, 1e-4, 0.6),), visibility=1.0))
        tracker.add_doas([sensors.doa(t, 0.2)])
        states.append(tracker.estimate(t).state)
    assert set(states[40:60]) == {State.VISUAL_ACTIVE} and set(states[62:]) == {State.ACOUSTIC_ACTIVE}


def test_a_higher_threshold_of_confirmation_holds_for_tracks_that_there_are():
    """The lower threshold confirms the side of a slowly turning rig at once; for the same track a higher one does so later."""
    began = []
    for threshold in (0.6, 0.9999):
        tracker, sensors, step, resolved = MultiTargetTracker(), SimulatedSensors(5), 0, False
        tracker.tune(0.5, 0.9999)
        while not resolved and step < 600:
            t, yaw = 100.0 + step / 20.0, math.radians(10.0) * step / 20.0
            if step == 10:
                assert tracker.filter.tracks
                tracker.tune(0.5, threshold)
            tracker.add_pose(Pose.level(t, yaw))
            tracker.add_doas([sensors.doa(t, float(wrap(0.4 - yaw)))])
            resolved, step = tracker.estimate(t).resolved, step + 1
        began.append(step)
    assert began[0] < began[1]


def test_a_late_image_does_not_break_a_target_that_is_surely_detected_where_it_is_in_view():
    """By a detection probability of 1, and an earlier image that does not show what was just seen."""
    tracker = MultiTargetTracker(TrackerSettings(FilterSettings(detection_probability=1.0)))
    for time, azimuth in ((100.0, 0.4), (99.99, -0.55)):
        tracker.add_camera(CameraMeasurement(time, (Detection(azimuth, 1e-8, 0.9, 0.1, 1e-8),)))
    tracker.add_camera(CameraMeasurement(100.1, ()))
    azimuths = [target.track.azimuth for target in tracker.targets(tracker.estimate(100.1)).targets]
    assert azimuths == pytest.approx([0.4, -0.55], abs=0.02)


def test_a_late_direction_from_the_side_does_not_break_what_is_heard_on_the_axis():
    """There the cosine has no slope, and by no mode is the late direction that of the same source."""
    tracker = MultiTargetTracker()
    for time, cosine in ((100.0, 1.0), (99.95, 0.0)):
        tracker.add_doas([DoaMeasurement.of_cone(time, Cone((1.0, 0.0, 0.0), cosine, 1e-4), 0.9)])
    components = [component for track in tracker.filter.tracks for component in track.mixture.components]
    assert len(components) > 1 and all(np.isfinite(component.covariances).all() for component in components)


def test_a_camera_that_has_stopped_tells_nothing_of_what_can_be_seen_now():
    """Its last visibility does not hold for as long as something is heard."""
    tracker, sensors = MultiTargetTracker(), SimulatedSensors(2)
    tracker.add_camera(CameraMeasurement(100.0, (), visibility=0.9))
    for step in range(80):
        tracker.add_doas([sensors.doa(100.0 + 0.1 * step, 2.0)])
        visibility = tracker.estimate(100.0 + 0.1 * step).visibility
        assert visibility == 0.9 if step < 40 else step < 60 or math.isnan(visibility)


def test_a_fixed_rotation_begins_anew_where_the_heading_was_corrected():
    """Else the rest of it would be turned, too."""
    tracker, sensors = GatedTracker(), SimulatedSensors(1)
    for step in range(30):
        time = 100.0 + 0.1 * step
        tracker.add_pose(Pose.level(time, math.radians(100.0) * (step >= 15), 1e-9))
        tracker.add_doas([sensors.doa(time, 0.5)])
        assert tracker.estimate(time).requested_rotation == pytest.approx(math.radians(45.0))
    assert tracker.motion.jumps == 1


class Newest(PlainTracker):
    """The newest azimuth."""

    def restart(self):
        self.newest = None

    def update(self, time, azimuth, variance, source):
        self.newest = azimuth, variance

    def predict(self, time):
        return self.newest


@pytest.mark.parametrize('name', ['sound_delay', 'sight_delay'])
def test_delays_of_stamps_hold_for_trackers_of_others(name):
    """A rig turns by 46 deg/s before a target in the east; the stamps are 0.4 s late."""
    tracker = Newest(node_parameters('av_fusion', 'fusion_node', overrides={name: 0.4}))
    for step in range(30):
        time, stamp = 100.0 + 0.1 * step, 99.9 + 0.1 * step
        tracker.add_pose(Pose.level(time, 0.8 * (time - 100.0), 0.8))
        azimuth = float(wrap(-0.8 * (stamp - 0.4 - 100.0)))
        if name == 'sound_delay':
            tracker.add_doas([DoaMeasurement(stamp, (Hypothesis(azimuth, 1e-4),), 0.9)])
        else:
            tracker.add_camera(CameraMeasurement(stamp, (Detection(azimuth, 1e-4, 0.9),)))
    assert tracker.estimate(time).azimuth_world == pytest.approx(0.0, abs=0.01)
