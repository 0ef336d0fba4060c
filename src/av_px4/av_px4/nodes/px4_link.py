"""PX4's topics: found in the graph with or without a version's suffix, with the quality of service that PX4 has."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from types import ModuleType
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from av_px4.topics import VersionError, check_version, find_topic

# PX4 writes BEST_EFFORT and TRANSIENT_LOCAL. VOLATILE readers are served, too, and are spared what was sent before they
# came: an old status must not look like a fresh one. PX4 reads BEST_EFFORT and VOLATILE.
PX4_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.BEST_EFFORT,
                     durability=DurabilityPolicy.VOLATILE)


def load_px4_msgs() -> ModuleType:
    """The messages of the firmware. Raises ImportError that says what to install."""
    try:
        return importlib.import_module('px4_msgs.msg')
    except ImportError as error:
        raise ImportError('px4_msgs is not installed: clone https://github.com/PX4/px4_msgs, the branch of your firmware '
                          '(such as release/1.16), into the workspace, and build and source it; see docs/px4.md') from error


class Px4Link:
    """Subscriptions and publishers that open when PX4's side of them appears."""

    def __init__(self, node: Node, prefix: str) -> None:
        """prefix: before `/out/` and `/in/`, such as `fmu`. Raises ImportError without px4_msgs."""
        self.messages = load_px4_msgs()
        self.problems: dict[str, str] = {}
        self._node, self._prefix = node, prefix
        self._wanted: dict[str, tuple[type, Callable[[Any], None]]] = {}
        self._inputs: dict[str, type] = {}
        self._subscriptions: dict[str, tuple[str, Any]] = {}
        self._publishers: dict[str, tuple[str, Any]] = {}

    def has(self, *message_names: str) -> bool:
        """Whether the firmware's px4_msgs has these messages."""
        return all(hasattr(self.messages, name) for name in message_names)

    def listen(self, name: str, message: str, callback: Callable[[Any], None]) -> None:
        """Subscribe to PX4's output `name` once it is there; nothing where the firmware's px4_msgs has no such message."""
        if self.has(message):
            self._wanted[name] = (getattr(self.messages, message), callback)

    def speak(self, name: str, message: str) -> None:
        """Publish to PX4's input `name` once it is there."""
        if self.has(message):
            self._inputs[name] = getattr(self.messages, message)

    def publish(self, name: str, message: Any) -> bool:
        """Send to PX4's input; False while PX4 has none of that name."""
        if name not in self._publishers:
            return False
        self._publishers[name][1].publish(message)
        return True

    def topic(self, name: str) -> str | None:
        """The topic in use for an output or input, None while there is none."""
        found = self._subscriptions.get(name) or self._publishers.get(name)
        return found[0] if found else None

    def discover(self) -> None:
        """Look for PX4's topics; opens what has appeared, and changes over when the firmware did."""
        known = [name for name, types in self._node.get_topic_names_and_types()
                 if any(kind.startswith('px4_msgs/') for kind in types)]
        written = [topic for topic in known if '/out/' in topic and self._node.count_publishers(topic)]
        read = [topic for topic in known if '/in/' in topic and self._node.count_subscribers(topic)]
        for name, (kind, callback) in self._wanted.items():
            self._open(name, 'out', kind, written, self._subscriptions, self._node.destroy_subscription,
                       lambda topic, kind=kind, callback=callback:
                       self._node.create_subscription(kind, topic, callback, PX4_QOS))
        for name, kind in self._inputs.items():
            self._open(name, 'in', kind, read, self._publishers, self._node.destroy_publisher,
                       lambda topic, kind=kind: self._node.create_publisher(kind, topic, PX4_QOS))

    def close(self) -> None:
        """Close everything."""
        for opened, destroy in ((self._subscriptions, self._node.destroy_subscription),
                                (self._publishers, self._node.destroy_publisher)):
            while opened:
                destroy(opened.popitem()[1][1])

    def _open(self, name: str, side: str, kind: type, names: list[str], opened: dict[str, tuple[str, Any]],
              destroy: Callable[[Any], Any], create: Callable[[str], Any]) -> None:
        topic = find_topic(self._node.resolve_topic_name(f'{self._prefix}/{side}/{name}'), names)
        if topic is None or (name in opened and opened[name][0] == topic):
            return
        if name in opened:
            destroy(opened.pop(name)[1])
        try:
            check_version(topic, kind)
        except VersionError as error:
            self.problems[name] = str(error)
            return
        self.problems.pop(name, None)
        opened[name] = (topic, create(topic))
