"""A rig that tilts, turns and flies, with a target, as messages: truth by scipy's rotations, errors Gaussian."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import Point, Quaternion, Vector3
from nav_msgs.msg import Odometry
from scipy.spatial.transform import Rotation
from vision_msgs.msg import Detection2D, Detection2DArray, ObjectHypothesisWithPose

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL
from av_common.parameters import node_parameters
from av_common.stamps import to_stamp
from av_common.track import Track
from av_fusion.measurement.converter import fixed_rotations
from av_fusion.stage import FusionStage, make_fusion_stage
from av_interfaces.msg import Doa, DoaArray, Visibility

START, STEP, WINDOW = 1000.0, 1.0 / 60.0, 0.25
CAMERA = PinholeCamera.from_fov(640, 480, math.radians(70.0))
COSINE_SIGMA, PIXEL_SIGMA = 0.02, 1.5
LEFT, FORWARD = (0.0, 1.0, 0.0), Rotation.identity()


@dataclass
class TiltedRig:
    """Feeds a stage with what the rig's sensors report. Functions take the time (s) since the start.

    Parameters:
        attitude: rotation of the body in the world.
        target: position (3; m) in the world.
        path: position (3; m) of the rig.
        reported: rotation that odometry reports; the attitude where None.
        sight, sound, odometry: whether the sensors work at a time.
        camera: rotation of the camera (x forward) on the body.
        axis: of the microphones in the body.
    """

    attitude: Callable[[float], Rotation]
    target: Callable[[float], np.ndarray]
    path: Callable[[float], np.ndarray] = lambda t: np.zeros(3)
    reported: Callable[[float], Rotation] | None = None
    sight: Callable[[float], bool] = lambda t: True
    sound: Callable[[float], bool] = lambda t: True
    odometry: Callable[[float], bool] = lambda t: True
    camera: Rotation = FORWARD
    axis: tuple[float, float, float] = LEFT
    seed: int = 1
    method: str = 'bayes'

    def __post_init__(self) -> None:
        self.random, self.tracks = np.random.default_rng(self.seed), []
        rotations = {'microphones': np.eye(3), 'camera': self.camera.as_matrix() @ FLU_TO_OPTICAL.T}
        parameters = node_parameters('av_fusion', 'fusion_node', overrides={'method': self.method})
        self.stage: FusionStage = make_fusion_stage(parameters, fixed_rotations(rotations), CAMERA, observer=self)

    def on_doa(self, measurements, arrival): ...

    def on_camera(self, measurement, message, arrival): ...

    def on_track(self, track: Track, time: float) -> None:
        self.tracks.append(track)

    def direction(self, time: float) -> np.ndarray:
        """Unit vector (3,) to the target in the world."""
        to = self.target(time) - self.path(time)
        return to / np.linalg.norm(to)

    def body(self, time: float) -> np.ndarray:
        """Unit vector (3,) to the target in the body."""
        return self.attitude(time).inv().apply(self.direction(time))

    def run(self, seconds: float) -> list[Track]:
        """Odometry at 30 Hz, sound at 10 Hz 0.3 s late, images at 15 Hz 0.1 s late; returns the tracks so far."""
        began = getattr(self, 'now', 0.0)
        for step in range(1, round(seconds / STEP) + 1):
            t = self.now = began + step * STEP
            if step % 2 == 0 and self.odometry(t):
                self.stage.on_odometry(self._odometry(t), START + t)
            if step % 4 == 0 and t > 0.1:
                self._see(t - 0.1, START + t)
            if step % 6 == 0 and t > 0.3 and self.sound(t - 0.3):
                self.stage.on_doa(self._doa(t - 0.3), START + t)
            self.stage.on_time(START + t)
        return self.tracks

    def errors(self, after: float = 2.0, frame: str = 'body') -> np.ndarray:
        """Angles (n; deg) between tracks and truth on the sphere, in the body or in the world."""
        found = []
        for track in self.tracks:
            t = track.time - START
            if t >= after:
                azimuth, elevation = ((track.azimuth, track.elevation) if frame == 'body'
                                      else (track.azimuth_world, track.elevation_world))
                truth = self.body(t) if frame == 'body' else self.direction(t)
                found.append(math.degrees(np.arccos(np.clip(unit(azimuth, elevation) @ truth, -1.0, 1.0))))
        return np.array(found)

    def azimuth_errors(self, after: float = 2.0) -> np.ndarray:
        """Errors (n; deg) of the azimuth in the body."""
        pairs = [(track.azimuth, self.body(track.time - START)) for track in self.tracks if track.time - START >= after]
        return np.degrees([math.remainder(azimuth - math.atan2(v[1], v[0]), math.tau) for azimuth, v in pairs])

    def _odometry(self, t: float) -> Odometry:
        attitude = (self.reported or self.attitude)(t)
        message = Odometry()
        message.header.stamp = to_stamp(START + t)
        x, y, z, w = map(float, attitude.as_quat())
        message.pose.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
        x, y, z = map(float, self.path(t))
        message.pose.pose.position = Point(x=x, y=y, z=z)
        rate = (self.attitude(t - 1e-4).inv() * self.attitude(t + 1e-4)).as_rotvec() / 2e-4
        velocity = self.attitude(t).inv().apply((self.path(t + 1e-4) - self.path(t - 1e-4)) / 2e-4)
        message.twist.twist.angular = vector(rate)
        message.twist.twist.linear = vector(velocity)
        return message

    def _doa(self, t: float) -> DoaArray:
        """Both images in the plane of the array, as a localizer reports them that knows no elevation."""
        times = t + np.linspace(-0.5 * WINDOW, 0.5 * WINDOW, 5)
        mean = float(np.mean([self.body(s) @ np.array(self.axis) for s in times]))
        cosine = min(max(mean + float(self.random.normal(0.0, COSINE_SIGMA)), -1.0), 1.0)
        apart, heading = math.acos(cosine), math.atan2(self.axis[1], self.axis[0])
        variance = COSINE_SIGMA**2 / max(1.0 - cosine**2, 0.02)
        images = [Doa(direction=vector(unit(heading + side * apart, 0.0)), azimuth=heading + side * apart, cosine=cosine,
                      azimuth_variance=variance, elevation_variance=math.inf, cosine_variance=COSINE_SIGMA**2, confidence=0.9)
                  for side in (-1.0, 1.0)]
        message = DoaArray(window=WINDOW, method='test', axis=vector(self.axis), hypotheses=images)
        message.header.stamp, message.header.frame_id = to_stamp(START + t), 'microphones'
        return message

    def _see(self, t: float, arrival: float) -> None:
        message = Detection2DArray()
        message.header.stamp, message.header.frame_id = to_stamp(START + t), 'camera'
        x, y, z = FLU_TO_OPTICAL @ self.camera.inv().apply(self.body(t))
        if self.sight(t) and z > 0.0:
            column, row = CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy
            if 0.0 <= column < 640.0 and 0.0 <= row < 480.0:
                result = ObjectHypothesisWithPose()
                result.hypothesis.class_id, result.hypothesis.score = 'drone', 0.9
                detection = Detection2D(results=[result])
                detection.bbox.center.position.x = column + float(self.random.normal(0.0, PIXEL_SIGMA))
                detection.bbox.center.position.y = row + float(self.random.normal(0.0, PIXEL_SIGMA))
                detection.bbox.size_x = detection.bbox.size_y = 15.0
                message.detections.append(detection)
        visibility = Visibility(visibility=0.9 if self.sight(t) else 0.0)
        visibility.header.stamp = message.header.stamp
        self.stage.on_visibility(visibility)
        self.stage.on_detections(message, arrival)


def unit(azimuth: float, elevation: float) -> np.ndarray:
    """Unit vector (3,) of an azimuth and an elevation in rad."""
    return np.array([math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation), math.sin(elevation)])


def vector(values: np.ndarray) -> Vector3:
    x, y, z = map(float, values)
    return Vector3(x=x, y=y, z=z)


def level(yaw_deg: float = 0.0) -> Callable[[float], Rotation]:
    """A level rig."""
    return lambda t: Rotation.from_euler('z', yaw_deg, degrees=True)


def swaying(amplitude_deg: float = 25.0, rate_deg: float = 60.0, yaw_rate_deg: float = 0.0) -> Callable[[float], Rotation]:
    """A rig that rolls and pitches by an amplitude with rates up to `rate_deg`, out of phase."""
    omega = rate_deg / max(amplitude_deg, 1e-9)
    return lambda t: Rotation.from_euler('ZYX', [yaw_rate_deg * t, amplitude_deg * math.sin(0.8 * omega * t),
                                                 amplitude_deg * math.sin(omega * t + 1.0)], degrees=True)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
