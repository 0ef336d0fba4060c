"""A participant of the DDS domain beside the rig: listens to it, tries to steer it, and prints what came of that.

`python3 participant.py NODE MARK [--call] [TOPIC...]` publishes messages with the frame MARK on these topics and, with
--call, sends requests, until its standard input ends. It prints its report twice a second, a line of JSON.
"""

from __future__ import annotations

import json
import sys
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import suppress

import rclpy
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.executors import ExternalShutdownException
from std_srvs.srv import SetBool

from av_common.node import Executor
from av_common.qos import RESULT
from av_interfaces.msg import Bearing, DoaArray, PointingCommand

KINDS = {'target/bearing': Bearing, 'pointing/command': PointingCommand, 'doa': DoaArray,
         'fmu/in/x': Bearing, 'fmu/out/x': Bearing}    # PX4's names; the type does not matter
DISABLE = SetParameters.Request(parameters=[Parameter(name='enabled', value=ParameterValue(
    type=ParameterType.PARAMETER_BOOL, bool_value=False))])
REQUESTS = {'pointing_node/set_parameters': (SetParameters, DISABLE), 'pointing_node/enable': (SetBool, SetBool.Request())}


class Participant:
    """Counts messages by topic and frame, and sends its requests as soon as there is somebody to answer them.

    Parameters:
        name: the node's name.
        mark: frame of its own messages.
        topics: topics to publish.
        call: whether to send requests.
    """

    def __init__(self, name: str, mark: str, topics: list[str], call: bool) -> None:
        self._mark = mark
        self._node = rclpy.create_node(name, start_parameter_services=False)
        self.heard: Counter[str] = Counter()
        self.refused: list[str] = []
        self.answered: list[str] = []
        self.nodes: set[str] = set()
        self._publishers, self._clients = {}, {}
        for topic in topics:
            self._try(topic, lambda topic=topic: self._publishers.update(
                {topic: self._node.create_publisher(KINDS[topic], topic, RESULT)}))
        for topic, kind in KINDS.items():
            self._try(f'hear {topic}', lambda topic=topic, kind=kind: self._node.create_subscription(
                kind, topic, lambda message: self._take(topic, message), RESULT))
        for service, (kind, _) in REQUESTS.items() if call else ():
            self._try(f'call {service}', lambda service=service, kind=kind: self._clients.update(
                {service: self._node.create_client(kind, service)}))
        self._timers = [self._node.create_timer(0.05, self._act), self._node.create_timer(0.5, self._report)]

    def _try(self, what: str, create: Callable[[], object]) -> None:
        try:
            create()
        except Exception:    # noqa: BLE001  (rclpy's RCLError is private)
            self.refused.append(what)

    def _take(self, topic: str, message: Bearing | PointingCommand | DoaArray) -> None:
        frame = message.header.frame_id
        self.heard[f'{topic} of {frame if frame.startswith("test_") else "the rig"}'] += 1
        self.heard['tracks'] += topic == 'target/bearing' and message.state != Bearing.STATE_NONE

    def _act(self) -> None:
        self.nodes |= set(self._node.get_node_names())
        for topic, publisher in self._publishers.items():
            message = KINDS[topic]()
            message.header.frame_id = self._mark
            message.header.stamp = self._node.get_clock().now().to_msg()
            publisher.publish(message)
        for service, client in list(self._clients.items()):
            if client.service_is_ready():
                del self._clients[service]
                future = client.call_async(REQUESTS[service][1])
                future.add_done_callback(lambda _, service=service: self.answered.append(service))
                self._pending = client    # a client without a reference would be destroyed

    def _report(self) -> None:
        print(json.dumps({'heard': self.heard, 'refused': self.refused, 'answered': self.answered,
                          'nodes': sorted(self.nodes)}), flush=True)

    def run(self) -> None:
        """Take part until the standard input ends."""
        executor = Executor()
        executor.add_node(self._node)
        threading.Thread(target=lambda: (sys.stdin.read(), rclpy.try_shutdown()), daemon=True).start()
        with suppress(ExternalShutdownException):
            executor.spin()


if __name__ == '__main__':
    rclpy.init()
    Participant(sys.argv[1], sys.argv[2], [word for word in sys.argv[3:] if word != '--call'], '--call' in sys.argv).run()
