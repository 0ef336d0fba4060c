"""Publishes detections with track numbers, and visibility, for image messages."""

from __future__ import annotations

import queue
import threading
import time
from contextlib import suppress
from typing import Any

import cv2
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from vision_msgs.msg import Detection2DArray

from av_common.node import RigNode, run
from av_common.qos import IMAGE, RESULT, STREAM
from av_common.rate_meter import RateMeter
from av_common.stamps import to_seconds
from av_common.tf_rotations import TfRotations
from av_interfaces.msg import Bearing, Visibility
from av_vision.drawing import draw
from av_vision.messages import image_message
from av_vision.nodes.detector_node_parameters import detector_node as parameters
from av_vision.sources.capture import STALE_S
from av_vision.stage import FROZEN_S, make_detection_stage


class DetectorNode(RigNode):
    """Runs the detection stage on the newest image of `camera/image_raw` and publishes `detections`, empty for no detection.

    The stage runs in a separate thread; images that arrive meanwhile replace each other and are counted as dropped.
    `visibility` is published for some of the images, the debug image `detections/image` only while it has subscribers.
    """

    def __init__(self, **kwargs: object) -> None:
        super().__init__('detector_node', parameters, **kwargs)

    def configure(self) -> None:
        """Open the model."""
        self._rotations = TfRotations(self)
        self._stage = make_detection_stage(self.settings)
        self._stage.mount(self._rotations.rotation)
        used, wanted = self._stage.detector.detector.model.provider, self.settings.providers[0]
        if used and used != wanted:
            self.get_logger().warning(f'{wanted} is not to be had here: the detector runs on {used}')
        self._detections = self.create_publisher(Detection2DArray, 'detections', RESULT)
        self._visibility = self.create_publisher(Visibility, 'visibility', RESULT)
        self._debug = self.create_publisher(Image, 'detections/image', IMAGE)

    def activate(self) -> None:
        """Begin to detect."""
        self._stage.reset()
        self._waiting: queue.Queue[Image | CompressedImage | None] = queue.Queue(1)
        self._dropped = 0
        self._images, self._took, self._delay = RateMeter(), 0.0, 0.0
        self._worker = threading.Thread(target=self._work, args=(self._waiting,), name='detector', daemon=True)
        self._worker.start()
        subscribe = self.create_subscription
        kind, topic = ((CompressedImage, 'camera/image_raw/compressed') if self.settings.compressed else
                       (Image, 'camera/image_raw'))
        subscribe(kind, topic, self._on_image, IMAGE)
        self.refuse_second_publishers(topic)
        subscribe(Image, 'camera/depth/image_raw', self._stage.on_depth, IMAGE)
        subscribe(CameraInfo, 'camera/camera_info', self._stage.on_camera_info, STREAM)
        self.subscribe_odometry(self._stage.on_odometry)
        subscribe(Bearing, 'target/bearing', self._stage.on_bearing, RESULT)

    def deactivate(self) -> None:
        """Stop detecting."""
        self._offer(None)
        self._worker.join(timeout=5.0)

    @staticmethod
    def check_parameters(settings: Any) -> None:
        """The size of the input must be one that models have."""
        if settings.input_size % 32:
            raise ValueError(f'input_size is {settings.input_size}, expected a multiple of 32')
        if settings.score_threshold >= 1.0:
            raise ValueError(f'score_threshold is {settings.score_threshold:g}, which no score exceeds; expected less than 1, '
                             'such as 0.25')

    def _on_image(self, message: Image | CompressedImage) -> None:
        if not self.contested:
            self._offer(message)

    def _offer(self, message: Image | CompressedImage | None) -> None:
        """Hand an image to the worker, in place of one that still waits; None ends it."""
        with suppress(queue.Empty):
            self._waiting.get_nowait()
            self._dropped += 1
        self._waiting.put(message)

    def _work(self, waiting: queue.Queue[Image | CompressedImage | None]) -> None:
        while (message := waiting.get()) is not None:    # until None: one that outlives a deactivation takes no later images
            try:
                self._detect(message)
            except Exception as error:  # noqa: BLE001  this thread is not one that the node guards
                self.refused.refuse('image', ValueError(error.err) if isinstance(error, cv2.error) else error)
                continue
            self._delay = self.now() - to_seconds(message.header.stamp)
            self._images.tick()

    def _detect(self, message: Image | CompressedImage) -> None:
        started = time.perf_counter()
        detections, visibility = self._stage.on_image(message, self.now())
        self._took = time.perf_counter() - started
        self._stage.detector.planner.took(self._took)
        if visibility is not None:
            self._visibility.publish(visibility)
        if detections is None:
            return
        self._detections.publish(detections)
        if self._debug.get_subscription_count() and self._stage.shown is not None:
            drawn = draw(self._stage.shown, *self._stage.detected)
            self._debug.publish(image_message(message.header, drawn, 'bgr8'))

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Report rate, time per image and losses."""
        model = self._stage.detector.detector.model
        status.add('execution provider', model.provider)
        if model.columns:
            status.add('columns of the model', model.columns)
        status.add('images per second', f'{self._images.rate:.1f}')
        status.add('time per image', f'{1e3 * self._took:.1f} ms')
        status.add('delay from capture', f'{1e3 * self._delay:.1f} ms')
        status.add('regions per image', str(self._stage.detector.planner.planned or 'all of it'))
        status.add('dropped (replaced by a newer image)', str(self._dropped))
        if self._images.age > STALE_S:
            status.mergeSummary(DiagnosticStatus.WARN, 'no images')
        elif self._stage.unchanged > FROZEN_S:
            status.mergeSummary(DiagnosticStatus.WARN, f'the same image for {self._stage.unchanged:.0f} s, to the bit: is the '
                                'camera frozen or covered? It is not used')


def main() -> None:
    """Entry point."""
    run(DetectorNode)
