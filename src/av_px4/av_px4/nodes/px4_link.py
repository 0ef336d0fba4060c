"""Subscriptions and publishers for PX4's topics, whose names may end in a version, with PX4's quality of service."""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from av_common.guarded_node import GuardedNode
from av_px4.handover import others_that_steer, steers
from av_px4.layouts import PROTOCOL, SILENT_S, LayoutCheck, layout_hash, mismatch, offered_versions, version_of
from av_px4.messages import characters, text

# PX4 publishes BEST_EFFORT and TRANSIENT_LOCAL. A VOLATILE subscriber is compatible and receives no message from before its
# subscription: an old status must not look like a fresh one. PX4's own subscribers are BEST_EFFORT and VOLATILE.
PX4_QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.BEST_EFFORT,
                     durability=DurabilityPolicy.VOLATILE)
ASK, ANSWER = 'message_format_request', 'message_format_response'
FMU = 'fmu/'  # before all of PX4's topics, in the namespace that UXRCE_DDS_NS gives it and the node has


def load_px4_msgs() -> ModuleType:
    """The module px4_msgs.msg. Raises ImportError with instructions for its installation."""
    try:
        return importlib.import_module('px4_msgs.msg')
    except ImportError as error:
        raise ImportError('px4_msgs is not installed: clone https://github.com/PX4/px4_msgs, the branch of your firmware (such '
                          'as release/1.16), into the workspace, and build and source it; see docs/guides/px4.md') from error


@cache
def installed_hash(kind: str) -> int | None:
    """PX4's hash of a message of the installed px4_msgs, None where definitions are not installed with it."""
    with suppress(OSError, PackageNotFoundError):
        folder = Path(get_package_share_directory('px4_msgs')) / 'msg'
        return layout_hash(kind, lambda name: (folder / f'{name}.msg').read_text())
    return None


class Px4Link:
    """Subscriptions and publishers that are created as soon as PX4's topics appear. Raises ImportError without px4_msgs.

    Of the versions of a topic, that of px4_msgs is used. While it is silent the others are watched without being decoded. A
    topic whose fields are others in the firmware is neither decoded nor written.

    Parameters:
        node: node that owns them

    Attributes:
        messages: the module px4_msgs.msg
        problems: what is wrong with the versions, by the topics' names without prefix and version
    """

    def __init__(self, node: GuardedNode) -> None:
        self.messages = load_px4_msgs()
        self.problems: dict[str, str] = {}
        self._node = node
        self._wanted: dict[str, tuple[type, Callable[[Any], None]]] = {}
        self._inputs: dict[str, type] = {}
        self._subscriptions: dict[str, tuple[str, Any]] = {}
        self._publishers: dict[str, tuple[str, Any]] = {}
        self._watched: dict[str, Any] = {}    # subscriptions to other versions
        self._heard: dict[str, float] = {}    # monotonic time in s of the newest message, by topic
        self._layouts = LayoutCheck(installed_hash)
        self._asks, self._begun = False, math.inf
        self._steering: set[str] = set()      # topics that steer the vehicle
        self.advertise(ASK, 'MessageFormatRequest')
        self.subscribe(ANSWER, 'MessageFormatResponse', self._on_layout)

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

    def publish(self, name: str, message: Any) -> None:
        """Publish a message to the input `name` of PX4, if PX4 has it."""
        if self.reads(name):
            self._publishers[name][1].publish(message)

    def reads(self, name: str) -> bool:
        """Whether PX4 reads the input `name`, with the fields of px4_msgs."""
        return name in self._publishers and self._layouts.may_use(f'in/{name}')

    def sends(self, name: str) -> bool:
        """Whether PX4 has the output `name`, with the fields of px4_msgs."""
        return name in self._subscriptions and self._layouts.may_use(f'out/{name}')

    def topic(self, name: str) -> str | None:
        """Full name of the topic of an output or input, None while PX4 does not have it."""
        found = self._subscriptions.get(name) or self._publishers.get(name)
        return found[0] if found else None

    def discover(self) -> None:
        """Search the ROS graph for PX4's topics, and open new ones."""
        known = [name for name, types in self._node.get_topic_names_and_types()
                 if any(kind.startswith('px4_msgs/') for kind in types)]
        written = [topic for topic in known if '/out/' in topic and self._node.count_publishers(topic)]
        read = [topic for topic in known if '/in/' in topic and self._node.count_subscribers(topic)]
        for name, kind in self._inputs.items():
            offered = self._offered(f'in/{name}', read)
            self._open(f'in/{name}', kind, offered, self._publishers,
                       partial(self._node.create_publisher, kind, qos_profile=PX4_QOS))
            # what PX4 reads cannot be silent: a version that is offered is right
            self._report(f'in/{name}', mismatch(kind, offered, dict.fromkeys(offered.values(), 0.0)))
        for name, (kind, callback) in self._wanted.items():
            offered = self._offered(f'out/{name}', written)
            self._open(f'out/{name}', kind, offered, self._subscriptions, partial(self._subscription, name, kind, callback))
            self._watch(name, kind, offered)
        self._begun = min(self._begun, time.monotonic()) if self._subscriptions else math.inf
        asks = ASK in self._publishers and ANSWER in self._subscriptions and self._hears(read)
        if asks and not self._asks:
            self._layouts.begin()
        self._asks = asks
        self._layouts.mute |= ASK not in self._publishers and time.monotonic() - self._begun > SILENT_S
        place = self._node.resolve_topic_name(f'{FMU}in/{ASK}').removesuffix(ASK)
        self._steering = {topic for topic in known if topic.startswith(place) and steers(topic.removeprefix(place))}

    def others(self) -> str:
        """Who else steers the vehicle, by the ROS graph; empty if nobody does."""
        publishers = {topic: [f'{info.node_namespace.rstrip("/")}/{info.node_name}'
                              for info in self._node.get_publishers_info_by_topic(topic)] for topic in self._steering}
        own = {topic: 1 for topic, _ in self._publishers.values()}
        return others_that_steer(self._node.get_fully_qualified_name(), own, publishers)

    def ask(self) -> None:
        """Ask PX4 for the next layout that is not known; to be called often."""
        topic = self._layouts.question(time.monotonic()) if self._asks else None
        if topic is not None:
            request = self.messages.MessageFormatRequest(protocol_version=PROTOCOL)
            request.topic_name = characters(f'{FMU}{topic}', request.topic_name)
            self._publishers[ASK][1].publish(request)

    def close(self) -> None:
        """Close all subscriptions and publishers."""
        self._node.destroy_entities([entity for _, entity in (*self._subscriptions.values(), *self._publishers.values())])
        self._node.destroy_entities(self._watched.values())
        for opened in (self._subscriptions, self._publishers, self._watched, self._heard):
            opened.clear()

    def _on_layout(self, message: Any) -> None:
        if message.protocol_version == PROTOCOL:
            self._layouts.answer(text(message.topic_name).removeprefix(FMU), message.success, message.message_hash)
            self.ask()

    def _hears(self, read: list[str]) -> bool:
        """Whether PX4 reads questions, and has sent anything within SILENT_S: else it may be another one when it does."""
        newest = max((self._heard.get(topic, -math.inf) for topic, _ in self._subscriptions.values()), default=-math.inf)
        return self._publishers[ASK][0] in read and time.monotonic() - newest <= SILENT_S

    def _offered(self, place: str, topics: list[str]) -> dict[int, str]:
        return offered_versions(self._node.resolve_topic_name(f'{FMU}{place}'), topics)

    def _subscription(self, name: str, kind: type, callback: Callable[[Any], None], topic: str) -> Any:
        def take(message: Any) -> None:
            self._hear(topic)
            if name == ANSWER or self._layouts.may_use(f'out/{name}'):
                callback(message)
        return self._node.create_subscription(kind, topic, take, PX4_QOS)

    def _hear(self, topic: str, _: object = None) -> None:
        self._heard[topic] = time.monotonic()

    def _open(self, place: str, kind: type, offered: dict[int, str], opened: dict[str, tuple[str, Any]],
              create: Callable[[str], Any]) -> None:
        """Open the version of px4_msgs. What was opened stays open, so that an agent that restarts finds it."""
        topic, name = offered.get(version_of(kind)), place.rpartition('/')[2]
        if topic is not None and name not in opened:
            if name not in (ASK, ANSWER):
                self._layouts.add(place, kind.__name__)
            opened[name] = (topic, create(topic))

    def _watch(self, name: str, kind: type, offered: dict[int, str]) -> None:
        """Watch the other versions while that of px4_msgs is silent, and report what is wrong."""
        now = time.monotonic()
        ages = {topic: now - self._heard.get(topic, -math.inf) for topic in offered.values()}
        own = offered.get(version_of(kind), '')
        rivals = {topic for topic in offered.values() if topic != own}
        silent = ages.get(own, math.inf) > SILENT_S
        for topic in rivals - set(self._watched) if silent else ():
            self._watched[topic] = self._node.create_subscription(kind, topic, partial(self._hear, topic), PX4_QOS, raw=True)
        if not silent:
            self._node.destroy_entities([self._watched.pop(topic) for topic in rivals if topic in self._watched])
        self._report(f'out/{name}', mismatch(kind, offered, ages))

    def _report(self, place: str, problem: str) -> None:
        problem, name = problem or self._layouts.problem(place), place.rpartition('/')[2]
        if problem:
            self.problems[name] = problem
        else:
            self.problems.pop(name, None)
