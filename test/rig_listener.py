"""Receives the messages of a rig that runs in another ROS domain."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage

from av_common.node import Executor
from av_common.qos import LATCHED, RESULT, STREAM
from av_common.track import State
from av_interfaces.msg import AudioFrame, Bearing, DoaArray, PointingCommand

GAP_S = 0.5
# One topic of each process; the simulator's images come through the bridge.
TOPICS = {'rig_frames_node': ('tf_static', TFMessage, LATCHED), 'doa_node': ('doa', DoaArray, STREAM),
          'fusion_node': ('target/bearing', Bearing, RESULT), 'pointing_node': ('pointing/command', PointingCommand, RESULT),
          'bridge_node': ('odometry', Odometry, STREAM), 'simulator': ('audio/frames', AudioFrame, STREAM)}


class RigListener:
    """Subscriptions in a ROS domain of their own; `close` after use.

    Attributes:
        commands, bearings: the newest commands and bearings, the newest one last.
        arrivals: time.monotonic() of the newest message of each process of TOPICS.
        tracked: time.monotonic() of the newest bearing with a target.
        tracked_since: the same of the first one after a gap of GAP_S.
        values: values of /diagnostics by name of the node and of the value.
    """

    def __init__(self, domain: int) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node('rig_listener', context=self._context)
        self._executor = Executor(context=self._context)
        self._executor.add_node(self._node)
        self.arrivals = dict.fromkeys(TOPICS, 0.0)
        self.commands: list[PointingCommand] = []
        self.bearings: list[Bearing] = []
        self.tracked = self.tracked_since = 0.0
        self.values: dict[str, dict[str, str]] = {}
        for name, (topic, kind, qos) in TOPICS.items():
            self._node.create_subscription(kind, topic, partial(self._on_message, name), qos)
        self._node.create_subscription(PointingCommand, 'pointing/command', self._on_command, RESULT)
        self._node.create_subscription(Bearing, 'target/bearing', self._on_bearing, RESULT)
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, QoSProfile(depth=50))

    def _on_message(self, name: str, message: object) -> None:
        self.arrivals[name] = time.monotonic()

    def _on_command(self, message: PointingCommand) -> None:
        self.commands = [*self.commands[-99:], message]

    def _on_bearing(self, message: Bearing) -> None:
        self.bearings = [*self.bearings[-199:], message]
        now = time.monotonic()
        if message.state != State.NONE:
            self.tracked_since = now if now - self.tracked > GAP_S else self.tracked_since
            self.tracked = now

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.values[status.name.partition(':')[0]] = {entry.key: entry.value for entry in status.values}

    def wait_for(self, condition: Callable[[], object], timeout: float = 60.0) -> bool:
        """Receive until the condition holds; False where it does not within the timeout (s)."""
        deadline = time.monotonic() + timeout
        while not condition() and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.05)
        return bool(condition())

    def enable(self, wanted: bool) -> str:
        """Call pointing_node's service ~/enable; returns its answer."""
        return self._call(SetBool, '/pointing_node/enable', SetBool.Request(data=wanted)).message

    def shut_down(self, name: str) -> bool:
        """Request the transition `shutdown` of an active node; returns whether it agreed."""
        transition = Transition(id=Transition.TRANSITION_ACTIVE_SHUTDOWN)
        return self._call(ChangeState, f'/{name}/change_state', ChangeState.Request(transition=transition)).success

    def _call(self, kind: Any, name: str, request: Any) -> Any:
        client = self._node.create_client(kind, name)
        assert client.wait_for_service(timeout_sec=30.0)
        answer = client.call_async(request)
        assert self.wait_for(answer.done)
        return answer.result()

    def close(self) -> None:
        """Leave the domain."""
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)
