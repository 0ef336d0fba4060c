"""Image messages in, detections with track numbers out."""

from __future__ import annotations

import threading
import time

import cv2
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2D, Detection2DArray, ObjectHypothesisWithPose

from av_common.node import RigNode, run
from av_common.qos import PICTURE, RESULT
from av_common.rate_meter import RateMeter
from av_common.stamps import to_seconds
from av_vision.drawing import draw
from av_vision.from_parameters import make_detector
from av_vision.image import fill_message, image_from_message
from av_vision.latest import Latest
from av_vision.nodes.detector_node_parameters import detector_node as parameters
from av_vision.nodes.visibility_reporter import VisibilityReporter
from av_vision.watching import Watcher
from av_vision.yolo import Detections

# Without a picture for this long the node says so.
STALE_S = 2.0


class DetectorNode(RigNode):
    """Looks at the newest picture of `camera/image_raw` and publishes `detections`, empty when nothing is seen.

    A thread of its own looks; pictures that arrive meanwhile replace each other and are counted as dropped. The debug
    picture `detections/image` is drawn only for subscribers.
    """

    def __init__(self, **kwargs: object) -> None:
        super().__init__('detector_node', parameters, **kwargs)

    def configure(self) -> None:
        """Open the model."""
        settings = self.settings
        self._detector = make_detector(settings)
        self._track_gap, self._still = settings.track_gap, settings.still
        self._compressed = settings.compressed
        self._publisher = self.create_publisher(Detection2DArray, 'detections', RESULT)
        self._debug = self.create_publisher(Image, 'detections/image', PICTURE)
        self._visibility = VisibilityReporter(self, settings)

    def activate(self) -> None:
        """Begin to look."""
        self._watcher = Watcher(self._detector, self._track_gap, self._still)
        self._latest: Latest[Image | CompressedImage] = Latest()
        self._pictures, self._unusable, self._problem_with_pictures, self._took = RateMeter(), 0, '', 0.0
        self._worker = threading.Thread(target=self._work, name='detector', daemon=True)
        self._worker.start()
        kind, topic = (CompressedImage, 'camera/image_raw/compressed') if self._compressed else (Image, 'camera/image_raw')
        self.while_active(self.create_subscription, kind, topic, self._latest.put, PICTURE)
        self._visibility.activate()

    def deactivate(self) -> None:
        """Stop looking."""
        self._latest.close()
        self._worker.join(timeout=5.0)

    def cleanup(self) -> None:
        """Drop what `configure` made."""
        self.destroy_publisher(self._publisher)
        self.destroy_publisher(self._debug)
        self._visibility.close()

    def _work(self) -> None:
        while (message := self._latest.take()) is not None:
            started = time.perf_counter()
            try:
                self._look(message)
            except (ValueError, cv2.error) as error:
                self._unusable += 1
                if str(error) != self._problem_with_pictures:
                    self.get_logger().error(f'picture left out: {error}')
                self._problem_with_pictures = str(error) or repr(error)
                continue
            self._took = time.perf_counter() - started
            self._pictures.tick()
            self._problem_with_pictures = ''

    def _look(self, message: Image | CompressedImage) -> None:
        image = image_from_message(message)
        detections, tracks = self._watcher.look(image, to_seconds(message.header.stamp))
        self._publisher.publish(to_message(detections, tracks, message.header))
        if self._debug.get_subscription_count():
            self._publish_debug(image, detections, tracks, message.header)
        self._visibility.report(image, message.header)

    def _publish_debug(self, image: NDArray, detections: Detections, tracks: list[int], header: Header) -> None:
        debug = fill_message(Image(), draw(image, detections, tracks), 'bgr8')
        debug.header = header
        self._debug.publish(debug)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Rate, time a picture takes, losses."""
        status.add('pictures per second', f'{self._pictures.rate:.1f}')
        status.add('time per picture', f'{1e3 * self._took:.1f} ms')
        status.add('dropped (a newer one came)', str(self._latest.dropped))
        status.add('unusable', str(self._unusable))
        if self._problem_with_pictures:
            status.mergeSummary(DiagnosticStatus.ERROR, self._problem_with_pictures)
        elif self._pictures.age > STALE_S:
            status.mergeSummary(DiagnosticStatus.WARN, 'no pictures')


def to_message(detections: Detections, tracks: list[int], header: Header) -> Detection2DArray:
    """The message of a picture's detections under the picture's header."""
    array = Detection2DArray(header=header)
    rows = zip(detections.centres.tolist(), detections.sizes.tolist(), detections.scores.tolist(), detections.class_names,
               tracks, strict=True)
    for centre, size, score, name, track in rows:
        hypothesis = ObjectHypothesisWithPose()
        hypothesis.hypothesis.class_id, hypothesis.hypothesis.score = name, score
        detection = Detection2D(header=header, results=[hypothesis], id=str(track))
        detection.bbox.center.position.x, detection.bbox.center.position.y = centre
        detection.bbox.size_x, detection.bbox.size_y = size
        array.detections.append(detection)
    return array


def main() -> None:
    """Entry point."""
    run(DetectorNode)
