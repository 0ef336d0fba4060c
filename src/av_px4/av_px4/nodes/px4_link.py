"""Subscriptions and publishers for PX4's topics, whose names may end in a version, with PX4's quality of service."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import partial
from types import ModuleType
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from av_px4.topics import VersionError, check_version, find_topic

# PX4 publishes BEST_EFFORT and TRANSIENT_LOCAL. A VOLATILE subscriber is compatible and receives no message from before its
# subscription: an old status must not look like a fresh one. PX4's own subscribers are BEST_EFFORT and VOLATILE.
PX4_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.BEST_EFFORT,
                     durability=DurabilityPolicy.VOLATILE)


def load_px4_msgs() -> ModuleType:
    """The module px4_msgs.msg. Raises ImportError with instructions for its installation."""
    try:
        return importlib.import_module('px4_msgs.msg')
    except ImportError as error:
        raise ImportError('px4_msgs is not installed: clone https://github.com/PX4/px4_msgs, the branch of your firmware (such '
                          'as release/1.16), into the workspace, and build and source it; see docs/guides/px4.md') from error


class Px4Link:
    """Subscriptions and publishers that are created as soon as PX4's topics appear. Raises ImportError without px4_msgs.

    Parameters:
        node: node that owns them
        prefix: the part of the topics' names before `/out/` and `/in/`, such as `fmu`
    """

    def __init__(self, node: Node, prefix: str) -> None:
        self.messages = load_px4_msgs()
        self.problems: dict[str, str] = {}
        self._node, self._prefix = node, prefix
        self._wanted: dict[str, tuple[type, Callable[[Any], None]]] = {}
        self._inputs: dict[str, type] = {}
        self._subscriptions: dict[str, tuple[str, Any]] = {}
        self._publishers: dict[str, tuple[str, Any]] = {}

    def subscribe(self, name: str, message: str, callback: Callable[[Any], None]) -> None:
        """Subscribe to an output of PX4 as soon as it exists. Without its message in px4_msgs there is no subscription.

        Parameters:
            name: name of the topic without prefix and version
            message: name of the message type in px4_msgs
            callback: function that is called with each message
        """
        if hasattr(self.messages, message):
            self._wanted[name] = (getattr(self.messages, message), callback)

    def advertise(self, name: str, message: str) -> None:
        """Create a publisher to an input of PX4 as soon as it exists.

        Parameters:
            name: name of the topic without prefix and version
            message: name of the message type in px4_msgs
        """
        if hasattr(self.messages, message):
            self._inputs[name] = getattr(self.messages, message)

    def publish(self, name: str, message: Any) -> bool:
        """Publish a message to the input `name` of PX4; False while PX4 does not subscribe to it."""
        if name not in self._publishers:
            return False
        self._publishers[name][1].publish(message)
        return True

    def topic(self, name: str) -> str | None:
        """Full name of the topic of an output or input, None while PX4 does not have it."""
        found = self._subscriptions.get(name) or self._publishers.get(name)
        return found[0] if found else None

    def discover(self) -> None:
        """Search the ROS graph for PX4's topics; open new ones, and reopen those whose version has changed."""
        known = [name for name, types in self._node.get_topic_names_and_types()
                 if any(kind.startswith('px4_msgs/') for kind in types)]
        written = [topic for topic in known if '/out/' in topic and self._node.count_publishers(topic)]
        read = [topic for topic in known if '/in/' in topic and self._node.count_subscribers(topic)]
        for name, (kind, callback) in self._wanted.items():
            self._open(name, 'out', kind, written, self._subscriptions, self._node.destroy_subscription,
                       partial(self._subscription, kind, callback))
        for name, kind in self._inputs.items():
            self._open(name, 'in', kind, read, self._publishers, self._node.destroy_publisher,
                       partial(self._publisher, kind))

    def close(self) -> None:
        """Close all subscriptions and publishers."""
        for opened, destroy in ((self._subscriptions, self._node.destroy_subscription),
                                (self._publishers, self._node.destroy_publisher)):
            while opened:
                destroy(opened.popitem()[1][1])

    def _subscription(self, kind: type, callback: Callable[[Any], None], topic: str) -> Any:
        return self._node.create_subscription(kind, topic, callback, PX4_QOS)

    def _publisher(self, kind: type, topic: str) -> Any:
        return self._node.create_publisher(kind, topic, PX4_QOS)

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
