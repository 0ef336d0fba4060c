"""Diagnosis of inputs with two sources."""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from rclpy.node import Node


class SourceReport:
    """Reports topics on which `SingleSource` refuses messages, with the publishers.

    Parameters:
        node: the node that subscribes.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._before: Mapping[str, int] = {}

    def report(self, status: DiagnosticStatusWrapper, refused: Mapping[str, int]) -> None:
        """Add the numbers of refused messages to a status, and an error for topics that refused some since the last report.

        Parameters:
            status: receives the report.
            refused: number of refused messages by topic.
        """
        for topic, count in refused.items():
            if count > self._before.get(topic, 0):
                publishers = ', '.join(sorted(info.node_name for info in self._node.get_publishers_info_by_topic(topic)))
                status.mergeSummary(DiagnosticStatus.ERROR, f'{topic} has two sources, whose stamps alternate, and is not used '
                                    f'until one of them ends (publishers: {publishers})')
            status.add(f'{topic} refused: two sources', str(count))
        self._before = dict(refused)
