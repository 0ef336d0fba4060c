"""The tracker asks for looks while the target is heard and not seen, and a look tells front from back as a turn does."""

import math

import numpy as np
import pytest
from simulated_sensors import SimulatedSensors

from av_common.angles import angles_to_direction, direction_to_angles, wrap
from av_common.gimbal_geometry import gimbal_to_body
from av_common.rig import GimbalMount
from av_common.track import State
from av_fusion.measurement.measurements import CameraMeasurement, Cone, Detection, DoaMeasurement
from av_fusion.measurement.rig_motion import Pose
from av_fusion.measurement.vectors import rows_of
from av_fusion.tracker import MultiTargetTracker, TrackerSettings

T = 1000.0
HALF_VIEW, HALF_HEIGHT = math.radians(35.0), math.radians(27.0)
GIMBAL = GimbalMount(pan_limits_deg=(-150.0, 150.0), tilt_limits_deg=(-45.0, 60.0))


class Rig:
    """A level rig that stands, two microphones on its y axis, and a gimbal or the body that obeys the track."""

    def __init__(self, azimuth, elevation, gimbal=GIMBAL, visibility=1.0, seed=1, tau=0.5):
        self.target = angles_to_direction(math.radians(azimuth), math.radians(elevation))
        self.tracker = MultiTargetTracker(TrackerSettings(gimbal=gimbal, tau=tau))
        self.gimbal, self.visibility, self.random = gimbal, visibility, np.random.default_rng(seed)
        self.pan = self.tilt = self.yaw = 0.0
        self.time, self.tracks = T, []

    def run(self, seconds, until=None):
        step = 0.05
        for count in range(round(seconds / step)):
            self.time += step
            self.tracker.add_pose(Pose.level(self.time, self.yaw))
            body = np.array([[math.cos(self.yaw), math.sin(self.yaw), 0.0], [-math.sin(self.yaw), math.cos(self.yaw), 0.0],
                             [0.0, 0.0, 1.0]]) @ self.target
            if count % 2 == 0:
                self._hear(body)
                self._see(body)
            track = self.tracker.estimate(self.time)
            self.tracks.append(track)
            if until is not None and until(track):
                break
            self._obey(track, step)
        return self.tracks[-1]

    def _hear(self, body):
        cosine = float(np.clip(body[1] + 0.02 * self.random.standard_normal(), -1.0, 1.0))
        self.tracker.add_doas([DoaMeasurement.of_cone(self.time - 0.25, Cone((0.0, 1.0, 0.0), cosine, 4e-4), 0.95)])

    def _see(self, body):
        camera = gimbal_to_body(self.gimbal or GIMBAL, self.pan, self.tilt)
        azimuth, elevation = direction_to_angles(camera.T @ body)
        inside = abs(azimuth) < HALF_VIEW and abs(elevation) < HALF_HEIGHT and self.visibility > 0.5
        found = tuple(map(float, direction_to_angles(body)))
        detections = (Detection(found[0], 1e-4, 0.9, found[1], 1e-4),) if inside else ()
        image = CameraMeasurement(self.time, detections, HALF_VIEW, HALF_HEIGHT, self.visibility, rows_of(camera))
        self.tracker.add_camera(image)

    def _obey(self, track, step):
        rate = math.radians(120.0) * step
        if track.look is not None:
            self.pan += float(np.clip(wrap(track.look[0]) - self.pan, -rate, rate))
            self.tilt += float(np.clip(track.look[1] - self.tilt, -rate, rate))
        elif track.requested_rotation:
            self.yaw += math.copysign(min(math.radians(40.0) * step, abs(track.requested_rotation)), track.requested_rotation)
        elif track.resolved and self.gimbal is None:
            self.yaw += float(np.clip(track.azimuth, -math.radians(40.0) * step, math.radians(40.0) * step))

    @property
    def error_deg(self):
        azimuth, _ = direction_to_angles(self.target)
        return abs(math.degrees(wrap(float(azimuth) - self.tracks[-1].azimuth_world)))


def seen(track):
    return track.resolved and track.state == State.VISUAL_ACTIVE


@pytest.mark.parametrize('azimuth', [130.0, -140.0, 170.0])
def test_a_look_shows_a_target_behind_in_half_the_time_of_a_turn(azimuth):
    by_look, by_turn = Rig(azimuth, 12.0), Rig(azimuth, 12.0, gimbal=None)
    for rig in (by_look, by_turn):
        rig.run(15.0, until=seen)
        assert seen(rig.tracks[-1])
    assert by_look.yaw == 0.0
    assert by_look.time - T <= 0.55 * (by_turn.time - T)
    by_look.run(0.5)
    assert by_look.error_deg < 3.0


def test_looks_end_as_the_target_is_seen():
    rig = Rig(130.0, 12.0)
    rig.run(15.0, until=seen)
    assert rig.tracks[-1].look is None
    assert any(track.look is not None for track in rig.tracks)


def test_a_look_that_shows_nothing_in_clear_air_tells_front_from_back():
    """Above the view of any look; what is not there is not seen, and counts."""
    rig = Rig(60.0, 12.0)
    rig.pan = math.radians(120.0)
    rig._obey = lambda track, step: None  # the camera rests at the mirror image, and sees nothing there
    track = rig.run(3.0)
    assert track.resolved
    assert rig.error_deg < 10.0


def test_in_dense_fog_the_body_turns():
    rig = Rig(130.0, 12.0, visibility=0.05)
    rig.run(6.0)
    assert all(track.look is None for track in rig.tracks)
    assert rig.yaw != 0.0


def test_a_fixed_camera_asks_for_no_looks():
    assert all(track.look is None for track in (Rig(130.0, 12.0, gimbal=None).run(2.0),))


def test_a_target_above_is_found_by_looking_up():
    rig = Rig(10.0, 32.0)  # above the view of a camera at rest
    rig.run(15.0, until=seen)
    assert seen(rig.tracks[-1])


def test_a_look_does_not_turn_with_the_correction_of_a_heading():
    """It is planned anew, instead of 120 deg off."""
    tracker, sensors, looks = MultiTargetTracker(TrackerSettings(gimbal=GimbalMount())), SimulatedSensors(1), []
    for step in range(24):
        time = 100.0 + 0.1 * step
        tracker.add_pose(Pose.level(time, math.radians(120.0) * (step >= 20), 1e-9))
        tracker.add_doas([sensors.doa(time, 1.0)])
        tracker.add_camera(CameraMeasurement(time - 0.02, (), visibility=0.9))
        looks.append(tracker.estimate(time + 0.01).look)
    assert tracker.motion.jumps == 1 and looks[19] is not None and looks[23] is not None
    assert all(abs(look[0] - looks[19][0]) < math.radians(10.0) for look in looks[20:] if look is not None)


def test_where_nothing_is_seen_is_looked_at_no_longer_with_a_tau_of_zero():
    """No detection has a score of 0, that of an image without."""
    looks = []
    for tau in (0.5, 0.0):
        rig = Rig(130.0, 12.0, visibility=0.5, tau=tau)
        rig.run(6.0)
        looks.append([track.look for track in rig.tracks])
    assert any(looks[0]) and looks[0] == looks[1]
