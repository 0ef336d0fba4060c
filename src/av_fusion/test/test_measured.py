"""`measured`, state, source and variance say what a bearing rests on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated_sensors import SimulatedSensors

from av_common.track import Source, State
from av_fusion.gated.tracker import GatedTracker
from av_fusion.tracker import MultiTargetTracker

START, END = 100.0, 106.0


def tracked(tracker, sensors=None, sight=True, sound=True, azimuth=0.3):
    """A tracker after 6 s of measurements at 20 Hz of a target that stands still in view."""
    sensors = sensors or SimulatedSensors(5)
    for k in range(round((END - START) * 20) + 1):
        t = START + k / 20.0
        if sound:
            tracker.add_doa(sensors.doa(t, azimuth))
        if sight:
            tracker.add_camera(sensors.camera(t, azimuth))
    return tracker, sensors


@pytest.mark.parametrize('sight, sound', [(True, False), (False, True), (True, True)])
@pytest.mark.parametrize('tracker_class', [MultiTargetTracker, GatedTracker])
def test_measurements_of_the_target_count_at_their_capture_time(tracker_class, sight, sound):
    tracker, _ = tracked(tracker_class(), sight=sight, sound=sound)
    assert tracker.estimate(END).measured == pytest.approx(END)
    assert tracker.estimate(END + 0.3).measured == pytest.approx(END)


@pytest.mark.parametrize('meanwhile', ['nothing', 'images without detections', 'images of fog', 'outliers', 'clutter'])
def test_nothing_else_counts(meanwhile):
    """Over 3 s of what is not the target: the bearing keeps its time, says that it is predicted, and widens."""
    tracker, sensors = tracked(MultiTargetTracker())
    before = tracker.estimate(END)
    for k in range(1, 61):
        t = END + k / 20.0
        if meanwhile.startswith('images'):
            tracker.add_camera(sensors.camera(t, 0.3, 0.05 if 'fog' in meanwhile else 0.5, detection_probability=0.0))
        elif meanwhile == 'outliers':
            tracker.add_doa(sensors.doa(t, -1.0))
        elif meanwhile == 'clutter':
            tracker.add_camera(sensors.camera(t, -0.5 + 0.02 * math.sin(9.0 * k)))
        track = tracker.estimate(t)
        if abs(track.azimuth - 0.3) > 0.4 or track.state == State.NONE:
            break  # another track, or none: then the old one was not kept alive
        assert track.measured <= END + 1e-9
        assert track.azimuth_variance >= 0.9 * before.azimuth_variance
        if t - END > 1.1:
            assert track.state == State.COASTING and track.source == Source.NOTHING
            assert track.azimuth_variance > 2.0 * before.azimuth_variance
        if t - END > 2.5:
            assert track.azimuth_variance > math.radians(10.0) ** 2
    else:
        assert meanwhile in ('nothing', 'images of fog', 'images without detections')


@pytest.mark.parametrize('tracker_class', [MultiTargetTracker, GatedTracker])
def test_a_prediction_has_the_variance_of_one(tracker_class):
    """5 s without input: whatever bearing is left admits that the target may have turned, and its hemisphere is open."""
    tracker, _ = tracked(tracker_class())
    sigmas, hemispheres = [], []
    for k in range(1, 110):
        track = tracker.estimate(END + 0.05 * k)
        assert track.measured in (0.0, pytest.approx(END))
        if track.state == State.NONE:
            break
        sigmas.append(math.sqrt(track.azimuth_variance))
        hemispheres.append(track.hemisphere_probability)
    assert sigmas == sorted(sigmas) and np.max(np.diff(hemispheres)) < 1e-9
    assert math.degrees(sigmas[-1]) > 25.0 and hemispheres[-1] < 0.99


def test_a_manoeuvre_during_silence_is_within_the_stated_sigma():
    """A target that stood still for seconds sets off at 8 deg/s when nothing is measured: within 2.5 sigma up to 3 s."""
    outside = []
    for seed in range(20):
        tracker, _ = tracked(MultiTargetTracker(), SimulatedSensors(seed), azimuth=0.2)
        for k in range(1, 31):
            track = tracker.estimate(END + 0.1 * k)
            if track.state != State.NONE:
                truth = 0.2 + math.radians(8.0) * 0.1 * k * (1.0 if seed % 2 else -1.0)
                outside.append(abs(track.azimuth - truth) > 2.5 * math.sqrt(track.azimuth_variance))
    assert len(outside) > 300 and sum(outside) < 0.05 * len(outside)
