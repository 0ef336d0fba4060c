"""The process that sends hostile messages, at a steady rate, as a peer on the same domain."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.managers import BaseManager
from pathlib import Path
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

NAME = 'attack_messages'
OWN = (NAME, observer.NAME)
COMMAND = '/pointing/command'
ALWAYS = {'/clock': 'rosgraph_msgs/msg/Clock', '/tf': 'tf2_msgs/msg/TFMessage'}
HEADER = 4                 # bytes of any serialized message
MOST_TEMPLATE = 100_000    # bytes; larger messages would make the load of the machine the attack


@dataclass
class Target:
    """A topic under attack: its name, class of messages, and a quality of service that all subscribers accept.

    Parameters:
        template: the newest genuine message as it was serialized; empty without.
    """

    topic: str
    kind: Any
    qos: QoSProfile
    template: bytes = b''

    def message(self) -> Any:
        """A genuine message, or an empty one."""
        return deserialize_message(self.template, self.kind) if self.template else self.kind()

    def keep(self, data: bytes) -> None:
        """Take a genuine message as the template."""
        if len(data) < MOST_TEMPLATE and MARK not in data:
            self.template = data


class Messages(Node):
    """Publishes on every topic to which a node of the rig subscribes, while an attack lasts."""

    def __init__(self) -> None:
        super().__init__(NAME)
        self._targets: list[Target] = []
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

    def spin(self, seconds: float) -> None:
        """Take what arrives, for some seconds."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=max(end - time.monotonic(), 0.0))

    def find(self, seconds: float = 4.0) -> list[str]:
        """Find the topics, and keep a genuine message of each; returns the topics' names."""
        self.spin(1.0)
        kinds, heard = ALWAYS | {topic: names[0] for topic, names in self.get_topic_names_and_types()}, []
        for topic, kind in sorted(kinds.items()):
            subscribers = [end for end in self.get_subscriptions_info_by_topic(topic) if end.node_name not in OWN]
            if subscribers or topic in ALWAYS:
                self._targets.append(Target(topic, get_message(kind), _qos(subscribers)))
                target = self._targets[-1]
                heard.append(self.create_subscription(target.kind, topic, target.keep, observer.DEEP, raw=True))
        self.spin(seconds)
        for subscription in heard:    # the next messages are the attack's own
            self.destroy_subscription(subscription)
        return [target.topic for target in self._targets]

    def attack(self, seconds: float, rate: float, seed: int, stale: bool = False, spare: tuple[str, ...] = ()
               ) -> dict[str, int]:
        """Send well-formed messages with hostile fields, genuine ones at another time, and damaged ones, in turns.

        The publishers are made for the attack and taken away with it. Returns the number of messages by topic.

        Parameters:
            seconds: duration.
            rate (Hz): of the messages on each topic.
            seed: of the random values.
            stale: whether all stamps are far from now.
            spare: topics to leave alone.
        """
        values = HostileValues(Random(seed))
        values.stale = stale
        publishers = [(target, self.create_publisher(target.kind, target.topic, target.qos)) for target in self._targets
                      if target.topic not in spare]
        sent, begun = Counter[str](), time.monotonic()
        for number in range(round(seconds * rate)):
            time.sleep(max(begun + number / rate - time.monotonic(), 0.0))
            if time.monotonic() > begun + seconds:
                break
            for target, publisher in publishers:
                try:
                    publisher.publish(MAKERS[number % len(MAKERS)](target, values))
                    sent[target.topic] += 1
                except Exception as error:  # noqa: BLE001  the middleware refuses some of them; rclpy has no class for it
                    sent[f'refused by the middleware: {str(error)[:60]}'] += 1
        for _, publisher in publishers:
            self.destroy_publisher(publisher)
        return dict(sent)


def typed(target: Target, values: HostileValues) -> Any:
    """A well-formed message, made of a genuine one or of nothing, with hostile fields and stamps, or stamps alone."""
    share = values.random.choice((0.0, 0.0, 0.02, 0.2, 0.7))
    message = target.message() if not share or values.random.random() < 0.7 else target.kind()
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
    if target.qos.reliability == ReliabilityPolicy.BEST_EFFORT and values.random.random() < 0.3:
        return values.random.randbytes(HEADER) + data[HEADER:]
    return data[:HEADER] + values.mutilate(data[HEADER:])


MAKERS = (typed, malformed)


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


def _connected() -> Messages:
    rclpy.init(args=[])
    return Messages()


def _log_to(log: Path) -> None:
    """Append what this process says to a file; the middleware says much."""
    with log.open('ab') as output:
        for descriptor in (1, 2):
            os.dup2(output.fileno(), descriptor)


class _Manager(BaseManager):
    """Has `Messages` in a process of its own."""


_Manager.register('messages', _connected, exposed=('find', 'attack'))


@contextmanager
def messages_beside(log: Path) -> Iterator[Any]:
    """`Messages` in a process of its own, whose output is appended to a file: its methods, by which exceptions come, too."""
    manager = _Manager(ctx=multiprocessing.get_context('spawn'))
    manager.start(_log_to, (log,))
    try:
        yield manager.messages()  # type: ignore[attr-defined]
    finally:
        manager.shutdown()
