"""Publishes the images of a file or a camera as Image and CameraInfo messages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from sensor_msgs.msg import CameraInfo, Image, Imu
from std_msgs.msg import Header

from av_common.camera import PinholeCamera
from av_common.node import RigNode, run
from av_common.playback import Playback
from av_common.qos import IMAGE, RESULT, STREAM
from av_common.rate_meter import RateMeter
from av_common.stamps import to_stamp
from av_vision.calibration import load_calibration
from av_vision.messages import camera_info_message, image_message
from av_vision.nodes.camera_node_parameters import camera_node as parameters
from av_vision.sources import Capture, CapturedImage, Source
from av_vision.sources.files import FileSource
from av_vision.sources.realsense import RealSenseSource
from av_vision.sources.v4l2 import DeviceSource

# Without an image for this long the diagnostics warn.
STALE_S = 2.0
Vector = tuple[float, float, float]


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
        self._capture = Capture(self._source, self._publish)
        self._capture.start()

    def deactivate(self) -> None:
        """Stop capturing."""
        if isinstance(self._source, FileSource):
            self._source.close()    # which may wait for a frame
        self._capture.stop()

    def _begin(self) -> float | None:
        """When a file begins (s), None while that is not known."""
        subscribers = self.get_subscriptions_info_by_topic(self._images.topic_name)
        return self._playback.begin({info.node_name for info in subscribers}, self.now())

    def _publish(self, image: CapturedImage) -> None:
        self._rate.tick()
        header = Header(stamp=to_stamp(image.time), frame_id=self._frame_id)
        self._images.publish(image_message(header, image.pixels, 'mono16' if image.pixels.dtype == np.uint16 else ''))
        camera = self._camera_of(image)
        if camera is not None:
            self._infos.publish(camera_info_message(header, camera))
        if self._depths is not None and image.depth is not None:
            self._depths.publish(image_message(header, image.depth, '16UC1'))

    def _publish_motion(self, time: float, angular_velocity: Vector, acceleration: Vector) -> None:
        message = Imu()
        message.header.stamp, message.header.frame_id = to_stamp(time), self._frame_id
        rate, force = message.angular_velocity, message.linear_acceleration
        rate.x, rate.y, rate.z = angular_velocity
        force.x, force.y, force.z = acceleration
        message.orientation_covariance[0] = -1.0  # REP-145: there is no orientation
        if self._motions is not None:
            self._motions.publish(message)

    def _camera_of(self, image: CapturedImage) -> PinholeCamera | None:
        """Its geometry; None, with a reason, for a calibration of other images: no bearing is better than a wrong one."""
        height, width = image.pixels.shape[:2]
        camera = self._calibration or image.camera or PinholeCamera.from_fov(width, height, self._fov)
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
            for problem in self._source.problems[:1]:
                status.mergeSummary(DiagnosticStatus.WARN, f'{len(self._source.problems)} images left out: {problem}')
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
