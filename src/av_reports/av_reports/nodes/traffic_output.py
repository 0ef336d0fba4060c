"""Positions of targets to PX4, as those of aircraft. It commands nothing; what PX4 does about traffic is PX4's setting."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from av_reports.contacts import PositionTrack
from av_reports.stage import Situation
from av_reports.traffic import load_px4_msgs, transponder_report

PX4_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.BEST_EFFORT,
                     durability=DurabilityPolicy.VOLATILE)  # that of PX4's own readers
TOPIC = 'fmu/in/transponder_report'  # to be added to PX4's dds_topics.yaml
INTERVAL_S = 1.0  # as aircraft report


class TrafficOutput:
    """Publishes a TransponderReport for each target and second.

    Parameters:
        node: owner of the publisher.
        geoid_height (m): of mean sea level above the ellipsoid.

    Raises ImportError without px4_msgs.
    """

    def __init__(self, node: Node, geoid_height: float) -> None:
        self._messages = load_px4_msgs()
        self._publisher = node.create_publisher(self._messages.TransponderReport, TOPIC, PX4_QOS)
        self._node, self._geoid_height = node, geoid_height
        self._sent: dict[int, float] = {}
        self._count = 0

    def report(self, situation: Situation) -> None:
        """Publish the positions that are due."""
        positions = [track for track in situation.tracks if isinstance(track, PositionTrack)]
        self._sent = {track.id: self._sent.get(track.id, 0.0) for track in positions}
        for track in positions:
            if situation.now - self._sent[track.id] >= 0.99 * INTERVAL_S:
                self._sent[track.id] = situation.now
                timestamp = self._node.get_clock().now().nanoseconds // 1000
                self._publisher.publish(transponder_report(self._messages, track, timestamp, self._geoid_height))
                self._count += 1

    def problem(self) -> str:
        """Why nothing arrives."""
        if self._publisher.get_subscription_count():
            return ''
        return f'nobody reads {self._publisher.topic_name}: add it to dds_topics.yaml of PX4'

    def values(self) -> dict[str, object]:
        """How many were sent."""
        return {'sent': self._count}

    def close(self) -> None:
        """Nothing is open: the publisher is the node's."""
