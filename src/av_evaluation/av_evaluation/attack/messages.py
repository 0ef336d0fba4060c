"""The process that sends hostile messages and requests as a peer on the same domain."""

from __future__ import annotations

import time
from collections import Counter
from random import Random
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosidl_runtime_py.utilities import get_message

from av_evaluation.attack import observer
from av_evaluation.attack.hostile import MARK, HostileValues
from av_evaluation.attack.pace import paced
from av_evaluation.attack.requests import Requests
from av_evaluation.attack.worker import serve

NAME = 'attack_messages'
OWN = (NAME, observer.NAME)
COMMAND = '/pointing/command'
ALWAYS = {'/clock': 'rosgraph_msgs/msg/Clock', '/tf': 'tf2_msgs/msg/TFMessage'}
HEADER = 4                 # bytes of any serialized message
MOST_TEMPLATE = 100_000    # bytes; larger messages would make the load of the machine the attack
# s by which a stamp jumps
JUMPS = (1e-3, -1e-3, 0.05, -0.05, 0.4, -0.4, 1.0, -1.0, 10.0, -10.0, 1e3, -1e3, 1e6, -1e6, 2e9, -2e9)


class Target:
    """A topic under attack.

    Parameters:
        node: the node that publishes.
        topic, kind: name and class of its messages.
        qos: quality of service that all subscribers accept.

    Attributes:
        template: the newest genuine message as it was serialized; empty before.
        best_effort: whether a message that is not understood is not sent again.
    """

    def __init__(self, node: Node, topic: str, kind: Any, qos: QoSProfile) -> None:
        self.topic, self.kind, self.template = topic, kind, b''
        self.best_effort = qos.reliability == ReliabilityPolicy.BEST_EFFORT
        self._node = node
        self._subscription: Any = node.create_subscription(kind, topic, self._keep, observer.DEEP, raw=True)
        self._publisher = node.create_publisher(kind, topic, qos)

    def listen(self) -> None:
        """Wait for no more templates: the next messages are the attack's own."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def message(self) -> Any:
        """A genuine message, or an empty one."""
        return deserialize_message(self.template, self.kind) if self.template else self.kind()

    def publish(self, message: Any) -> None:
        """Publish a message, or bytes as a serialized one."""
        self._publisher.publish(message)

    def _keep(self, data: bytes) -> None:
        if len(data) < MOST_TEMPLATE and MARK not in data:
            self.template = data


class Messages(Node):
    """Publishes on every topic to which a node of the rig subscribes."""

    def __init__(self) -> None:
        super().__init__(NAME)
        self._targets: dict[str, Target] = {}
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)
        self.requests = Requests(self, self.spin)

    def spin(self, seconds: float = 0.0) -> None:
        """Take what arrives, for at least `seconds`."""
        end = time.monotonic() + seconds
        self._executor.spin_once(timeout_sec=seconds)
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=max(end - time.monotonic(), 0.0))

    def find(self, seconds: float = 4.0) -> list[str]:
        """Find the topics, and keep a genuine message of each; returns their names."""
        self.spin(1.0)
        kinds = ALWAYS | {topic: names[0] for topic, names in self.get_topic_names_and_types()}
        for topic, kind in kinds.items():
            subscribers = [end for end in self.get_subscriptions_info_by_topic(topic) if end.node_name not in OWN]
            if topic not in self._targets and (subscribers or topic in ALWAYS):
                self._targets[topic] = Target(self, topic, get_message(kind), _qos(subscribers))
        self.spin(seconds)
        for target in self._targets.values():
            target.listen()
        return sorted(self._targets)

    def attack(self, kind: str, seconds: float, rate: float, seed: int, stale: bool = False,
               spare: tuple[str, ...] = ()) -> dict[str, int]:
        """Send messages; returns their number by topic.

        Parameters:
            kind: `typed`, `malformed`, `mixed` (both) or `clocks`.
            seconds: duration.
            rate (Hz): of the messages on each topic.
            seed: of the random values.
            stale: whether all stamps are far from now.
            spare: topics to leave alone.
        """
        values = HostileValues(Random(seed))
        values.stale = stale
        targets = [target for topic, target in sorted(self._targets.items()) if topic not in spare]
        sent: Counter[str] = Counter()
        for number in paced(seconds, rate * len(targets)):
            target = targets[number % len(targets)]
            make = {'typed': typed, 'malformed': malformed, 'clocks': jumping,
                    'mixed': (typed, malformed)[number // len(targets) % 2]}[kind]
            try:
                target.publish(make(target, values))
            except Exception as error:  # noqa: BLE001  the middleware refuses some of them; rclpy has no class for it
                sent[f'refused by the middleware: {str(error)[:60]}'] += 1
                continue
            sent[target.topic] += 1
        return dict(sent)


def typed(target: Target, values: HostileValues) -> Any:
    """A well-formed message, made of a genuine one or of nothing, with hostile fields."""
    share = values.random.choice((0.02, 0.2, 0.7))
    message = target.message() if values.random.random() < 0.7 else target.kind()
    values.disturb(message, share)
    if hasattr(message, 'transforms'):
        _break_rotations(message, values)
    if target.topic == COMMAND:
        message.reason = MARK.decode() + message.reason[:100]
    return message


def malformed(target: Target, values: HostileValues) -> bytes:
    """A serialized message that is damaged: behind its header, and on best-effort topics in its header, too.

    The middleware drops the packet with a damaged header; a reliable publisher would repeat it, and what follows would wait.
    """
    made = target.topic == COMMAND or not target.template or values.stale
    data = serialize_message(typed(target, values)) if made else target.template
    if target.best_effort and values.random.random() < 0.3:
        return values.random.randbytes(HEADER) + data[HEADER:]
    return data[:HEADER] + values.mutilate(data[HEADER:])


def jumping(target: Target, values: HostileValues) -> Any:
    """A genuine message whose stamp jumps."""
    message = target.message()
    seconds, fraction = divmod(min(max(time.time() + values.random.choice(JUMPS), -2.0**31), 2.0**31 - 1.0), 1.0)
    stamps = [item for item in (getattr(message, 'header', message), message) if hasattr(item, 'stamp')]
    for item in stamps:
        item.stamp.sec, item.stamp.nanosec = int(seconds), int(1e9 * fraction)
    if hasattr(message, 'clock'):
        message.clock = values.stamp()
    if hasattr(message, 'transforms'):
        _break_rotations(message, values)
    if target.topic == COMMAND:
        message.reason = MARK.decode()
    return message


def _break_rotations(message: Any, values: HostileValues) -> None:
    """A peer may move a frame by a valid rotation, for good: names of the rig's frames go with invalid ones only."""
    for item in message.transforms:
        if values.random.random() < 0.5:
            item.child_frame_id = f'hostile_{values.random.randrange(20)}'
        else:
            item.transform.rotation.w = values.random.choice((float('nan'), float('inf'), 3.0))


def _qos(subscribers: list[Any]) -> QoSProfile:
    profiles = [end.qos_profile for end in subscribers]
    reliable = any(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    latched = any(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=10,
        reliability=ReliabilityPolicy.RELIABLE if reliable or latched else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


def main() -> None:
    """Send what is asked for until standard input is closed."""
    rclpy.init()
    node = Messages()
    requests = node.requests
    serve({'find': node.find, 'attack': node.attack, 'lifecycle': requests.lifecycle, 'parameters': requests.parameters,
           'restore': requests.restore, 'enable': requests.enable}, node.spin)
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
