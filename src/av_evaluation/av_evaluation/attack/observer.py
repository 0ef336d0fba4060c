"""What the rig does during an attack: commands, bearings and truth, heard in a thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from ament_index_python.packages import get_package_share_directory
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from av_common.guarded_node import Reader
from av_common.parameters import node_parameters
from av_common.stamps import to_seconds
from av_evaluation.attack.hostile import MARK
from av_evaluation.attack.judges import BearingCheck, CommandJudge
from av_interfaces.msg import Bearing, PointingCommand
from av_pointing.settings import pointing_settings

NAME = 'attack_observer'
DEEP = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)
PERIOD_S = 0.02  # between looks, in which 500 messages of a topic may wait


class Observer:
    """Hears the rig and lets its judges judge. What cannot be decoded is not the rig's, and is ignored.

    Attributes:
        lock: to be held while a judge is asked.
        commands, bearings: the judges.
    """

    def __init__(self) -> None:
        rclpy.init(args=[])
        self._node = Node(NAME)
        shipped = Path(get_package_share_directory('av_bringup')) / 'config' / 'rig_params.yaml'
        self.lock, self._closing = threading.Lock(), threading.Event()
        self.commands = CommandJudge(pointing_settings(node_parameters('av_pointing', 'pointing_node', [shipped])))
        self.bearings = BearingCheck()
        self._inputs: list[tuple[Reader, Any, Callable[[Any, float], None]]] = []
        self._hear(PointingCommand, 'pointing/command', lambda message, _: self.commands.on_command(
            message, to_seconds(message.header.stamp)))
        self._hear(Bearing, 'target/bearing', self.bearings.on_bearing)
        for name in ('rig', 'target'):
            self._hear(Odometry, f'truth/{name}', partial(self.bearings.on_truth, name))
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and the node."""
        self._closing.set()
        self._thread.join(5.0)
        self._node.destroy_node()
        rclpy.try_shutdown()

    def _hear(self, kind: Any, topic: str, take: Callable[[Any, float], None]) -> None:
        subscription = self._node.create_subscription(kind, topic, lambda _: None, DEEP, raw=True)
        self._inputs.append((Reader(subscription), kind, take))

    def _run(self) -> None:
        while not self._closing.wait(PERIOD_S):
            with self.lock:
                for reader, kind, take in self._inputs:
                    for data, published in reader.take():
                        self._take(data, published, kind, take)
                self.bearings.judge(time.time())

    def _take(self, data: bytes, published: float, kind: Any, take: Callable[[Any, float], None]) -> None:
        if MARK not in data:
            try:
                take(deserialize_message(data, kind), published)
            except Exception as error:  # noqa: BLE001  an attacker's message; rclpy has no class for this error
                self._node.get_logger().debug(str(error))
