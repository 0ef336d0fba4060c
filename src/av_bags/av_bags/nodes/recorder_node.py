"""Records topics of the rig to a bag."""

from __future__ import annotations

from array import array
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosbags.interfaces import QosDurability, QosReliability
from rosidl_runtime_py.utilities import get_message
from sensor_msgs.msg import CompressedImage, Image

from av_bags.background_writer import BackgroundWriter
from av_bags.nodes.recorder_node_parameters import recorder_node as parameters
from av_bags.topics import KINDS
from av_bags.writer import DEFAULT_QOS
from av_common.guarded_node import decode
from av_common.launched import restarts
from av_common.node import RigNode, run
from av_vision.messages import encoding_of, image_from_message

DISCOVERY_PERIOD_S = 0.2  # between looks at the graph; messages before are lost
JPEG_QUALITY = 95  # of compressed images
# For the messages that arrive while another callback runs; of images some 10 MB.
QUEUE_DEPTH, IMAGE_QUEUE_DEPTH = 100, 10


def compress(data: bytes) -> bytes:
    """Compress a serialised Image to a serialised CompressedImage with the format string of image_transport.

    Parameters:
        data: an Image in CDR; 8-bit pixels become JPEG, 16-bit pixels lossless PNG.

    Raises ValueError for pixels of other types, which neither format can hold, and for unreadable images.
    """
    message = decode(Image, data)
    image = image_from_message(message)
    if image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f'images of encoding {message.encoding} cannot be compressed; record them raw')
    kind, name = 'jpeg' if image.dtype == np.uint8 else 'png', encoding_of(image)
    _, encoded = cv2.imencode(f'.{kind}', image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return bytes(serialize_message(CompressedImage(
        header=message.header, format=f'{name}; {kind} compressed {name}', data=array('B', encoded.tobytes()))))


class RecorderNode(RigNode):
    """Subscribes to topics as they appear, with the publishers' quality of service, and records serialised messages.

    Each activation begins a bag, from the second one on with a number.
    """

    def __init__(self, **kwargs: object) -> None:
        super().__init__('recorder_node', parameters, **kwargs)
        self._number = restarts()

    def configure(self) -> None:
        """Read the parameters. Raises ValueError for an empty path."""
        self._settings = self.settings
        if not self._settings.path:
            raise ValueError('path is empty, expected the bag to write, such as flight.mcap')

    def activate(self) -> None:
        """Create the bag and start to look for topics."""
        self._missing = [self.resolve_topic_name(name) for name in self._settings.topics]
        self._known = {self.resolve_topic_name(name): kinds for name, kinds in KINDS.items()}
        self._kinds: dict[str, str] = {}    # of the topics that are recorded
        self._unusable: dict[str, str] = {}
        path = numbered(datetime.now().strftime(self._settings.path), self._number)
        self._writer = BackgroundWriter(path)
        self.get_logger().info(f'recording to {self._writer.bag.file}')
        self.create_steady_timer(DISCOVERY_PERIOD_S, self._find_topics)

    def deactivate(self) -> None:
        """Finish the bag. Raises OSError when the disk refuses its end."""
        self._number += 1
        self._writer.close()
        count = sum(self._writer.bag.counts.values())
        self.get_logger().info(f'recorded {count} messages, {1e-6 * self._writer.bag.bytes_written:.1f} MB, '
                               f'to {self._writer.bag.file}')

    def _find_topics(self) -> None:
        if not self.get_clock().now().nanoseconds:
            return  # simulated time has not begun, and messages would have no time
        for name in list(self._missing):
            publishers = self.get_publishers_info_by_topic(name)
            if publishers:
                self._missing.remove(name)
                try:
                    self._record(name, publishers)
                except (ValueError, ImportError, AttributeError) as error:
                    self._unusable[name] = str(error)
                    self.get_logger().error(f'{name} is not recorded: {error}')

    def _record(self, name: str, publishers: list[TopicEndpointInfo]) -> None:
        """Subscribe to a topic; of several types to the rig's own, else to the first one.

        Raises ValueError, ImportError or AttributeError when it is not installed.
        """
        kinds = [publisher.topic_type for publisher in publishers]
        kind = next((kind for kind in self._known.get(name, ()) if kind in kinds), kinds[0])
        publishers = [publisher for publisher in publishers if publisher.topic_type == kind]
        recorded_as, recorded_kind, encode = name, kind, None
        is_image = kind == 'sensor_msgs/msg/Image'
        if is_image and self._settings.images != 'raw':
            if self._settings.images == 'none':
                return
            recorded_as, recorded_kind = f'{name}/compressed', 'sensor_msgs/msg/CompressedImage'
            encode = compress
        qos = common_qos(publishers, IMAGE_QUEUE_DEPTH if is_image else QUEUE_DEPTH)
        offered = DEFAULT_QOS._replace(reliability=QosReliability(int(qos.reliability)),
                                       durability=QosDurability(int(qos.durability)))
        self._writer.add_topic(recorded_as, recorded_kind, offered, encode)
        put, clock = self._writer.put, self.get_clock()
        self.create_subscription(get_message(kind), name,
                                 lambda data: put(recorded_as, clock.now().nanoseconds, data), qos, raw=True)
        self._kinds[name] = kind

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Report recorded and lost messages."""
        writer = self._writer
        for name, why in self._unusable.items():
            status.mergeSummary(DiagnosticStatus.WARN, f'{name} is not recorded: {why}')
        for name, kind in self._kinds.items():
            others = ', '.join(sorted({each.topic_type for each in self.get_publishers_info_by_topic(name)} - {kind}))
            if others:
                status.mergeSummary(DiagnosticStatus.WARN, f'{name} is recorded as {kind}: {others} is left out')
        for count, why in ((writer.dropped, 'the disk is too slow'), (writer.unencoded, writer.encoding_problem)):
            if count:
                status.mergeSummary(DiagnosticStatus.WARN, f'{count} messages lost: {why}')
        if writer.problem:
            status.mergeSummary(DiagnosticStatus.ERROR, writer.problem)
        status.add('file', str(writer.bag.file))
        status.add('size (MB)', f'{1e-6 * writer.bag.bytes_written:.1f}')
        status.add('lost messages', str(writer.dropped + writer.unencoded))
        status.add('not published so far', ', '.join(self._missing))
        for topic, count in writer.bag.counts.items():
            status.add(f'{topic} messages', str(count))


def numbered(path: str, number: int) -> str:
    """The path of a bag that continues another one.

    Parameters:
        path: path of the first bag.
        number: number of the continuation; 0 for the first bag itself.
    """
    first = Path(path)
    return str(first.with_name(f'{first.stem}_{number}{first.suffix}')) if number else path


def common_qos(publishers: list[TopicEndpointInfo], depth: int) -> QoSProfile:
    """The strictest profile that is compatible with all publishers.

    Parameters:
        publishers: of the topic.
        depth: largest number of messages that wait.
    """
    reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
    latched = all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


def main() -> None:
    """Run the node."""
    run(RecorderNode)
