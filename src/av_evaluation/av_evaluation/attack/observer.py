"""The process that observes the rig during an attack: commands, bearings, truth and diagnostics."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from vision_msgs.msg import Detection2DArray

from av_common.parameters import node_parameters
from av_common.stamps import to_seconds
from av_evaluation.attack.bearing_check import BearingCheck
from av_evaluation.attack.command_judge import CommandJudge
from av_evaluation.attack.hostile import MARK
from av_evaluation.attack.worker import serve
from av_interfaces.msg import Bearing, DoaArray, PointingCommand
from av_pointing.settings import pointing_settings

NAME = 'attack_observer'
DEEP = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)


class Observer(Node):
    """Subscribes serialized messages: what cannot be decoded is not the rig's, and is ignored.

    Messages are taken without an executor, which takes too long for as many as the attack sends.
    """

    def __init__(self) -> None:
        super().__init__(NAME)
        shipped = Path(get_package_share_directory('av_bringup')) / 'config' / 'rig_params.yaml'
        self.judge = CommandJudge(pointing_settings(node_parameters('av_pointing', 'pointing_node', [shipped])))
        self.check = BearingCheck()
        self._problems: dict[str, str] = {}
        self._inputs: list[tuple[Any, Callable[[bytes, dict[str, int]], None]]] = []
        self._watch(PointingCommand, 'pointing/command', self._on_command)
        self._watch(Bearing, 'target/bearing', self._on_bearing)
        self._watch(DoaArray, 'doa', partial(self._on_measurement, 'hypotheses'))
        self._watch(Detection2DArray, 'detections', partial(self._on_measurement, 'detections'))
        self._watch(Odometry, 'odometry', self._on_odometry)
        self._watch(Odometry, 'truth/rig', partial(self._on_truth, 'rig'))
        self._watch(Odometry, 'truth/target', partial(self._on_truth, 'target'))
        self._watch(DiagnosticArray, '/diagnostics', self._on_diagnostics)

    def _watch(self, kind: Any, topic: str, take: Callable[[Any, float], None]) -> None:
        def decode(data: bytes, info: dict[str, int]) -> None:
            if MARK in data:
                return
            try:
                take(deserialize_message(data, kind), 1e-9 * info['source_timestamp'])
            except Exception as error:  # noqa: BLE001  an attacker's message; rclpy has no class for this error
                self.get_logger().debug(str(error))
        self._inputs.append((self.create_subscription(kind, topic, decode, DEEP, raw=True), decode))

    def look(self) -> None:
        """Take what has arrived, and judge what arrived long enough before."""
        now = time.time()
        for subscription, decode in self._inputs:
            for _ in range(DEEP.depth):
                with subscription.handle:
                    taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    break
                decode(*taken)
        self.judge.judge(now)
        self.check.judge(now)

    def _on_command(self, message: PointingCommand, _: float) -> None:
        self.judge.on_command(message, to_seconds(message.header.stamp), time.time())

    def _on_bearing(self, message: Bearing, published: float) -> None:
        self.check.on_bearing(message, published)
        self.judge.on_bearing(published, to_seconds(message.measured))

    def _on_measurement(self, field: str, message: Any, published: float) -> None:
        if len(getattr(message, field)) > 0:
            self.judge.on_input('measurement', published, to_seconds(message.header.stamp))

    def _on_odometry(self, message: Odometry, published: float) -> None:
        self.judge.on_input('odometry', published, to_seconds(message.header.stamp))

    def _on_truth(self, name: str, message: Odometry, published: float) -> None:
        self.check.on_truth(name, message, published)

    def _on_diagnostics(self, message: DiagnosticArray, _: float) -> None:
        self._problems.update({status.name: status.message for status in message.status})

    def begin(self, still_from: float | None = None) -> None:
        """Start to judge another attack; nothing may move from `still_from` (s) on, None where it may."""
        self.judge.begin(math.inf if still_from is None else still_from)

    def end(self) -> None:
        """What was stopped or disabled goes on from now on, and may move."""
        self.judge.end(time.time())

    def quiet(self, since: float) -> None:
        """The attack is over since a time (s): what it said about the truth does not count."""
        self.check.forget_truth(since)

    def recovered(self, since: float) -> float | None:
        """Time (s) after `since` from which on bearings are true; None where they are not yet."""
        return self.check.recovered(since)

    def faces(self, angle: float) -> bool:
        """Whether the body faces the target within an angle (rad)."""
        return abs(self.check.azimuth) < angle

    def share(self, begin: float, end: float) -> float:
        """Share of true bearings between two times (s)."""
        return self.check.share(begin, end)

    def faults(self, begin: float, end: float) -> str:
        """What was wrong with the bearings between two times (s)."""
        return self.check.faults(begin, end)

    def findings(self) -> dict[str, Any]:
        """What was found since `begin`, and the newest state in the diagnostics of each node."""
        return {**asdict(self.judge.findings), 'diagnostics': self._problems}


def main() -> None:
    """Observe until standard input is closed."""
    rclpy.init()
    observer = Observer()

    def idle(seconds: float) -> None:
        observer.look()
        time.sleep(seconds)
    functions = (observer.begin, observer.end, observer.quiet, observer.recovered, observer.faces, observer.share,
                 observer.faults, observer.findings, observer.judge.forget)
    serve({function.__name__: function for function in functions}, idle)
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
