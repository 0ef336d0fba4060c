"""Self-calibration finds a rotated axis, a wrong baseline and bent delays, and wrong detections do no harm."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_sensors import SimulatedSensors

from av_common.angles import wrap
from av_common.rig import CAMERAS
from av_fusion.calibration.array_calibration import SIGMAS, ArraySelfCalibration
from av_fusion.calibration.sighting_calibration import SightingCalibration
from av_fusion.measurement.measurements import CameraMeasurement, Cone, Detection, DoaMeasurement
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.measurement.vectors import angles, direction, rows_of
from av_fusion.tracker import MultiTargetTracker, TrackerSettings
from av_fusion.tracks.motion import Elevation, MotionModel
from av_fusion.tracks.settings import FilterSettings


def biased_measurement(time, azimuth, offset, scale, random, sigma=0.01):
    """What a pair on the y axis reports whose axis is off by `offset` rad and whose baseline is `scale` too long."""
    cosine = np.clip((1.0 + scale) * math.cos(azimuth - 0.5 * math.pi - offset) + random.normal(0.0, sigma), -0.999, 0.999)
    return DoaMeasurement.of_cone(time, Cone((0.0, 1.0, 0.0), cosine, sigma**2), 0.95)


def error_after_sight(enabled, offset_deg=5.0, scale=0.05, wrong_share=0.0, seed=1):
    """RMS error (deg) of sound alone, after 20 s in which the camera saw the target swinging."""
    random = np.random.default_rng(seed)
    sensors = SimulatedSensors(seed)
    level = MotionModel(elevations=(Elevation(0.0, math.radians(10.0) ** 2, 1.0),))
    tracker = MultiTargetTracker(TrackerSettings(FilterSettings(level), self_calibration=enabled))
    errors = []
    for step in range(20 * 32):
        t = 100.0 + step / 20.0
        truth = 0.5 * math.sin(0.5 * (t - 100.0))
        if t < 120.0:
            camera = sensors.camera(t, truth)
            if random.random() < wrong_share:
                camera = camera._replace(detections=(Detection(float(random.uniform(-0.5, 0.5)), 1e-4, 0.9, 0.0, 0.01),))
            tracker.add_camera(camera)
        tracker.add_doas([biased_measurement(t, truth, math.radians(offset_deg), scale, random)])
        track = tracker.estimate(t)
        if t > 122.0:
            errors.append(math.degrees(wrap(track.azimuth - truth)))
    return float(np.sqrt(np.mean(np.square(errors)))), tracker


@pytest.mark.parametrize(('offset_deg', 'scale'), [(5.0, 0.0), (-5.0, 0.05), (0.0, -0.05), (5.0, 0.05)])
def test_a_calibrated_array_is_nearly_as_accurate_as_an_ideal_one(offset_deg, scale):
    """An axis 5 degrees off and 5 % of baseline leave at most half a degree more error than an ideal array."""
    good, _ = error_after_sight(False, 0.0, 0.0)
    without, _ = error_after_sight(False, offset_deg, scale)
    refined, _ = error_after_sight(True, offset_deg, scale)
    assert refined < good + 0.5
    assert refined < 0.5 * without or without < good + 0.5


def test_an_ideal_array_stays_ideal():
    """Where there is nothing to correct, nothing gets worse."""
    without, _ = error_after_sight(False, 0.0, 0.0)
    refined, tracker = error_after_sight(True, 0.0, 0.0)
    assert refined < without + 0.3
    assert np.all(np.abs(tracker.self_calibration.values) < 2.0 * SIGMAS)


@pytest.mark.parametrize('seed', range(3))
def test_wrong_detections_do_not_make_it_diverge(seed):
    """With a third of the detections anywhere in view corrections stay bounded, and the error is no larger than without."""
    without, _ = error_after_sight(False, 5.0, 0.05, 0.33, seed)
    refined, tracker = error_after_sight(True, 5.0, 0.05, 0.33, seed)
    assert refined < without + 0.3
    assert np.all(np.abs(tracker.self_calibration.values) <= 2.0 * SIGMAS + 1e-12)


def test_the_parameters_are_found():
    """From directions all around, each of the five parameters is within three of its sigmas."""
    random, self_calibration = np.random.default_rng(3), ArraySelfCalibration()
    truth = np.array([math.radians(4.0), 0.03, 0.01, -0.01, 0.01])
    for k in range(3000):
        azimuth, elevation = random.uniform(-math.pi, math.pi), random.uniform(0.0, 0.5)
        x = math.cos(azimuth) * math.cos(elevation)
        measured = (truth[2] + (1.0 + truth[1]) * math.cos(azimuth + truth[0]) * math.cos(elevation)
                    + truth[3] * (1.5 * x * x - 0.5) + truth[4] * (2.5 * x**3 - 1.5 * x) + random.normal(0.0, 0.01))
        self_calibration.compare(0.02 * k, measured, azimuth, elevation, 0.01**2)
    assert np.all(np.abs(self_calibration.values - truth) < 3.0 * self_calibration.sigmas + 0.003)


def test_it_says_when_it_stands_at_its_limit():
    """An axis 20 deg off is more than may be corrected; 4 deg are learnt silently."""
    for offset_deg, expected in ((20.0, True), (4.0, False)):
        learnt = error_after_sight(True, offset_deg, 0.0)[1].diagnostics()['self-calibration at its limit']
        assert ('axis offset -10.00' in learnt) is expected, learnt    # o is the angle of the axis the other way round


def test_it_forgets_towards_the_array_as_described():
    """Long after sight was lost a few comparisons do not hold on to an old error."""
    self_calibration = ArraySelfCalibration()
    for k in range(200):
        self_calibration.compare(0.05 * k, math.cos(1.2) + 0.05, 1.2, 0.0, 1e-3)
    learned = float(np.abs(self_calibration.values).sum())
    for k in range(200):
        self_calibration.compare(100.0 + k, math.cos(1.2), 1.2, 0.0, 1e-3)
    assert float(np.abs(self_calibration.values).sum()) < 0.3 * learned


def test_implausible_comparisons_are_refused():
    """NaN, infinite variances and impossible cosines have no effect."""
    self_calibration = ArraySelfCalibration()
    for measured, variance in ((math.nan, 0.01), (0.5, math.inf), (0.5, 0.0), (30.0, 0.01)):
        assert not self_calibration.compare(0.0, measured, 1.0, 0.0, variance)
    assert not np.any(self_calibration.values)


def test_it_can_be_switched_off():
    """Off means off."""
    _, tracker = error_after_sight(False)
    assert tracker.self_calibration.compared == 0 and isinstance(CameraMeasurement(0.0, ()), CameraMeasurement)


def test_a_misaligned_camera_has_little_effect():
    """With a camera 1 degree off at 20 degrees, within its sigma, an ideal array moves by less than 4 at 60 degrees."""
    tracker, sensors = MultiTargetTracker(), SimulatedSensors(1, math.radians(0.5))
    self_calibration = tracker.self_calibration
    for step in range(10 * 20):
        t, truth = 100.0 + step / 20.0, 0.0 if step < 100 else math.radians(20.0)
        tracker.add_camera(sensors.camera(t, truth * 1.05))
        tracker.add_doas([sensors.doa(t, truth)])
    angle = math.radians(30.0)  # from the axis
    moved = math.acos(self_calibration.correct(math.cos(angle), angle)[0]) - angle
    assert self_calibration.compared > 100 and abs(math.degrees(moved)) < 4.0


def test_a_corrected_direction_keeps_all_else_that_was_measured():
    """Its probability of being a drone, its fundamental and its window."""
    calibration, random = ArraySelfCalibration(), np.random.default_rng(2)
    for step in range(50):
        cosine = biased_measurement(0.1 * step, 0.3, math.radians(5.0), 0.0, random).cone.cosine
        calibration.compare(0.1 * step, cosine, 0.5 * math.pi - 0.3, 0.0, 1e-4, 1e-4)
    given = biased_measurement(6.0, 0.3, math.radians(5.0), 0.0, random)._replace(
        window=0.3, drone_probability=0.9, fundamental=150.0, fundamental_variance=4.0)
    corrected = calibration.corrected(given)
    assert corrected.cone.axis != given.cone.axis
    assert corrected._replace(hypotheses=given.hypotheses, cone=given.cone) == given


@pytest.mark.parametrize('on_gimbal', [False, True])
def test_a_second_camera_is_aligned_with_the_first(on_gimbal):
    """Its frame is turned by 3 deg to the left and 1 deg up; both turn on the body where a gimbal carries them."""
    motion, random, wrong = RigMotion(), np.random.default_rng(4), Rotation.from_euler('zy', [3.0, -1.0], degrees=True)
    calibration = SightingCalibration(True, 0.0, motion)
    for k in range(400):
        time = 0.05 * k
        yaw, pan = 0.4 * math.sin(0.9 * time), 0.5 * math.sin(0.7 * time) * on_gimbal
        motion.add(Pose.level(time, yaw, 0.36 * math.cos(0.9 * time)))
        ray = Rotation.from_euler('z', -yaw - pan).apply(direction(0.09 * math.sin(time), 0.09)) + random.normal(0.0, 2e-3, 3)
        ray = ray if k % 2 == 0 else wrong.inv().apply(ray)
        mount = Rotation.from_euler('z', pan)
        azimuth, elevation = angles(tuple(mount.apply(ray)))
        image = CameraMeasurement(time, (Detection(azimuth, 1e-5, 0.9, elevation, 1e-5),), view=rows_of(mount.as_matrix()),
                                  camera=CAMERAS[k % 2])
        seen = calibration.align(time, image)
        assert k % 2 or seen is image
    x, y, z = np.degrees(calibration.cameras[CAMERAS[1]].values)
    assert abs(x) < 1.0 and abs(y + 1.0) < 0.2 and abs(z - 3.0) < 0.2
    seen = calibration.align(time, image)
    expected = Rotation.from_euler('z', pan) * wrong
    assert np.allclose(direction(seen.detections[0].azimuth, seen.detections[0].elevation), expected.apply(ray), atol=4e-3)
    assert np.allclose(seen.view, expected.as_matrix(), atol=0.02)


def test_a_second_camera_that_begins_later_and_sends_late_images_is_aligned():
    """Its first image shows something of before the newest image of the first camera."""
    motion = RigMotion()
    calibration = SightingCalibration(True, 0.0, motion)
    for k in range(20):
        time = 0.05 * k
        motion.add(Pose.level(time, 0.0))
        image = CameraMeasurement(time, (Detection(0.1, 1e-5, 0.9, 0.1, 1e-5),))
        calibration.align(time, image)
        if k >= 10:
            late = image._replace(time=time - 0.12, camera=CAMERAS[1])
            calibration.align(late.time, late)
    assert calibration.cameras[CAMERAS[1]].compared == 10


def test_after_a_step_of_the_clock_back_it_learns_and_forgets_as_before():
    """An array that was mended meanwhile is known as well as by a clock that went on."""
    learned = []
    for later in (1010.0, 10.0):
        calibration = ArraySelfCalibration()
        for k in range(200):
            calibration.compare(1000.0 + 0.05 * k, math.cos(1.2) + 0.05, 1.2, 0.0, 1e-3, 1e-4)
        for k in range(2000):
            calibration.compare(later + 0.05 * k, math.cos(1.2), 1.2, 0.0, 1e-3, 1e-4)
        learned.append(float(np.abs(calibration.values).sum()))
    assert learned[1] == pytest.approx(learned[0], abs=1e-3)
