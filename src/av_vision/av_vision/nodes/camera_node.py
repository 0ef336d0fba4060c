"""Publishes the images of a file or a camera as Image and CameraInfo messages."""

from __future__ import annotations

import math
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from sensor_msgs.msg import CameraInfo, Image, Imu
from std_msgs.msg import Header

from av_common.camera import DISTORTION_LENGTHS, LENS_MODELS, PinholeCamera
from av_common.config_reader import ConfigError, number
from av_common.files import shown
from av_common.node import RigNode, run
from av_common.playback import Playback
from av_common.pose_messages import vector_message
from av_common.qos import IMAGE, RESULT, STREAM
from av_common.rate_meter import RateMeter
from av_common.stamps import to_stamp
from av_common.yaml_reader import load_yaml
from av_vision.messages import camera_info_message, image_message
from av_vision.nodes.camera_node_parameters import camera_node as parameters
from av_vision.sources.capture import STALE_S, Capture, DeviceSource, Frame, Source
from av_vision.sources.files import FileSource
from av_vision.sources.realsense import RealSenseSource

Vector = tuple[float, float, float]
ENTRIES = ('image_width', 'image_height', 'camera_name', 'camera_matrix', 'distortion_model', 'distortion_coefficients',
           'rectification_matrix', 'projection_matrix')
ALIKE = 0.8    # likeness of two names, of which one is a misspelling of the other (difflib)


def load_calibration(path: str | Path) -> PinholeCamera:
    """The camera of a calibration file. Raises ValueError or OSError that name the file and the entry that is wrong."""
    content = load_yaml(path, 'calibration')
    try:
        if not isinstance(content, dict):
            raise ConfigError(f'{shown(content)}, expected a mapping with image_width and camera_matrix')
        for name in content:    # other programs add entries of their own
            meant = get_close_matches(str(name), ENTRIES, 1, ALIKE)
            if meant and name not in ENTRIES and meant[0] not in content:
                raise ConfigError(f'{shown(name)} is no entry of a calibration, the nearest is {meant[0]}')
        matrix, model = _numbers(content, 'camera_matrix', (9,)), content.get('distortion_model', LENS_MODELS[0])
        distortion = _numbers(content, 'distortion_coefficients', DISTORTION_LENGTHS)
        width, height = (int(number(content.get(name), name, True, {'low': 1}))
                         for name in ('image_width', 'image_height'))
        return PinholeCamera.from_calibration(width, height, matrix, str(model), distortion)
    except ValueError as error:
        raise ValueError(f'calibration {path}: {error}') from error


def _numbers(content: dict[str, Any], name: str, lengths: tuple[int, ...]) -> tuple[float, ...]:
    """The list `data` of an entry, which may be absent where a length of 0 is allowed."""
    entry = content.get(name, {} if 0 in lengths else None)
    data = entry.get('data', [] if 0 in lengths else None) if isinstance(entry, dict) else entry
    if not isinstance(data, list) or len(data) not in lengths:
        raise ConfigError(f'{name}.data: {shown(data)}, expected a list of {" or ".join(map(str, lengths))} numbers')
    return tuple(number(value, f'{name}.data[{index}]') for index, value in enumerate(data))


class CameraNode(RigNode):
    """Publishes `camera/image_raw` and `camera/camera_info` from the capturing thread, stamped with the time of capture."""

    def __init__(self, **kwargs: object) -> None:
        super().__init__('camera_node', parameters, **kwargs)

    def configure(self) -> None:
        """Read the calibration and make the source."""
        settings = self.settings
        self._frame_id = settings.frame_id
        self._fov = math.radians(settings.horizontal_fov_deg)
        self._calibration = load_calibration(settings.calibration_file) if settings.calibration_file else None
        self._source = self._make_source(settings)
        self._images = self.create_publisher(Image, 'camera/image_raw', IMAGE)
        self._infos = self.create_publisher(CameraInfo, 'camera/camera_info', RESULT)
        self._depths = self.create_publisher(Image, 'camera/depth/image_raw', IMAGE) if settings.depth else None
        self._motions = self.create_publisher(Imu, 'imu/data_raw', STREAM) if settings.imu else None

    def _make_source(self, settings: Any) -> Source:
        if settings.source == 'file':
            if not settings.file:
                raise ValueError('file is empty, expected a video, an image or a folder of images')
            return FileSource(settings.file, settings.rate, settings.loop, self.now, begin=self._begin)
        kind, _, serial = settings.device.partition(':')
        if kind == 'realsense':
            return RealSenseSource(serial, settings.width, settings.height, settings.rate or 30.0, settings.exposure_ms,
                                   settings.depth, self._publish_motion if settings.imu else None, now=self.now)
        return DeviceSource(settings.device, settings.width, settings.height, settings.rate, settings.exposure_ms, self.now,
                            settings.pixel_format)

    def activate(self) -> None:
        """Begin to capture."""
        self._rate, self._misfit = RateMeter(), ''
        self._playback = Playback(self.get_name())
        self._capture = Capture(self._source, self._take)
        self._capture.start()

    def deactivate(self) -> None:
        """Stop capturing."""
        if not isinstance(self._source, DeviceSource):
            self._source.close()    # others may wait for a frame
        self._capture.stop()

    def _begin(self) -> float | None:
        """When a file begins (s), None while that is not known."""
        subscribers = self.get_subscriptions_info_by_topic(self._images.topic_name)
        return self._playback.begin({info.node_name for info in subscribers}, self.now())

    def _take(self, frame: Frame) -> None:
        try:
            self._publish(frame)
        except Exception as error:  # noqa: BLE001  this thread is not one that the node guards
            self.refused.refuse('image', error)

    def _publish(self, frame: Frame) -> None:
        self._rate.tick()
        header = Header(stamp=to_stamp(frame.time), frame_id=self._frame_id)
        self._images.publish(image_message(header, frame.image))
        camera = self._camera_of(frame)
        if camera is not None:
            self._infos.publish(camera_info_message(header, camera))
        if self._depths is not None and frame.depth is not None:
            self._depths.publish(image_message(header, frame.depth, '16UC1'))

    def _publish_motion(self, time: float, angular_velocity: Vector, acceleration: Vector) -> None:
        message = Imu(header=Header(stamp=to_stamp(time), frame_id=self._frame_id),
                      angular_velocity=vector_message(angular_velocity), linear_acceleration=vector_message(acceleration))
        message.orientation_covariance[0] = -1.0  # REP-145: there is no orientation
        if self._motions is not None:
            self._motions.publish(message)

    def _camera_of(self, frame: Frame) -> PinholeCamera | None:
        """Its geometry; None, with a reason, for a calibration of other images: no bearing is better than a wrong one."""
        height, width = frame.image.shape[:2]
        camera = self._calibration or frame.camera or PinholeCamera.from_fov(width, height, self._fov)
        try:
            camera, self._misfit = camera.scaled(width, height), ''
        except ValueError as error:
            if not self._misfit:
                self._misfit = f'calibration_file {self.settings.calibration_file}: {error}; so there is no camera/camera_info'
                self.get_logger().error(self._misfit)
            return None
        return camera

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Report rate, losses and the end of a file."""
        status.add('images per second', f'{self._rate.rate:.1f}')
        status.add('reconnections', str(self._capture.reconnections))
        if isinstance(self._source, FileSource):
            status.add('skipped', str(self._source.skipped))
            if self._source.recording.problem:
                status.mergeSummary(DiagnosticStatus.WARN, self._source.recording.problem)
        if self._capture.problem:
            status.mergeSummary(DiagnosticStatus.ERROR, self._capture.problem)
        elif self._misfit:
            status.mergeSummary(DiagnosticStatus.ERROR, self._misfit)
        elif self._capture.finished:
            status.mergeSummary(DiagnosticStatus.WARN, 'the file has ended')
        elif self._rate.age > STALE_S:
            status.mergeSummary(DiagnosticStatus.WARN, 'no images')


def main() -> None:
    """Entry point."""
    run(CameraNode)
