"""A bag to the rig's topics and /clock, in its own time or faster."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from itertools import chain

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from rosidl_runtime_py.utilities import get_message
from tf2_msgs.msg import TFMessage

from av_bags import topics as names
from av_bags.converters import AudioLayout
from av_bags.errors import BagError
from av_bags.feed import SECOND, BagRecord, Feed
from av_bags.nodes.player_node_parameters import player_node as parameters
from av_bags.reader import FOREVER, Bag
from av_bags.topics import STAGES, find_topics, parse_remappings
from av_common.node import RigNode, run
from av_common.qos import LATCHED
from av_common.stamps import to_stamp

# Reliable, and deep enough for a burst: nothing of a bag should be lost again.
PLAYED = QoSProfile(depth=100)
# For nodes that work off what came last, before the end of the bag ends everything.
LINGER_S = 1.0
# From the first subscription of a node to its last.
SETTLE_S = 0.5


class PlayerNode(RigNode):
    """Plays on a thread of its own and ends the process when the bag has ended."""

    def __init__(self, **kwargs: object) -> None:
        super().__init__('player_node', parameters, **kwargs)

    def configure(self) -> None:
        """Open the bag and the publishers."""
        self._settings = settings = self.settings
        self._bag = bag = Bag(settings.bag)
        found = find_topics(bag, self._wanted(), parse_remappings(settings.remap), settings.recorded_namespace)
        if not found.topics:
            raise BagError(f'{settings.bag} has nothing to play for only={settings.only}: '
                           f'{"; ".join(found.missing.values())}')
        for reason in found.missing.values():
            self.get_logger().info(reason)
        layout = AudioLayout(settings.audio_rate, settings.audio_channels, settings.audio_format)\
            if settings.audio_rate else None
        start_ns = bag.start_ns + round(settings.start * SECOND)
        stop_ns = start_ns + round(settings.duration * SECOND) if settings.duration else FOREVER
        self._latched = found.topics.pop(names.FRAMES, None)
        self._feed = Feed(bag, found.topics, layout, start_ns, stop_ns, decode=False)
        self._length = (min(stop_ns - 1, bag.end_ns) - start_ns) / SECOND
        self._outputs = {name: self.create_publisher(get_message(names.KINDS[name][0]), name, PLAYED)
                         for name in found.topics}
        self._clock_output = self.create_publisher(Clock, '/clock', 10)
        self._frames_output: Publisher | None = None
        self._played, self._position = 0, 0.0

    def _wanted(self) -> tuple[str, ...]:
        wanted = STAGES[self._settings.only]
        if self._settings.only == 'raw' and not self._settings.detections:
            wanted = tuple(name for name in wanted if name not in (names.DETECTIONS, names.VISIBILITY))
        return wanted

    def activate(self) -> None:
        """Begin to play."""
        if self._latched is not None:
            self._frames_output = self.create_publisher(TFMessage, names.FRAMES, LATCHED)
            self._frames_output.publish(self._static_frames(self._latched))
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name='play', daemon=True)
        self._thread.start()

    def deactivate(self) -> None:
        """Stop playing."""
        self._stopping.set()
        self._thread.join()

    def cleanup(self) -> None:
        """Close bag and publishers."""
        self._bag.close()
        for publisher in filter(None, (*self._outputs.values(), self._clock_output, self._frames_output)):
            self.destroy_publisher(publisher)

    def _run(self) -> None:
        records = iter(self._feed)
        first = next(records, None)
        if first is not None:
            self._wait_for_subscribers(first.arrival)
            self._play(chain([first], records), first.arrival)
        for problem in (*self._bag.problems, *self._feed.problems):
            self.get_logger().error(problem)
        self.get_logger().info(f'played {self._played} messages, {self._position:.1f} s')
        if not self._stopping.wait(LINGER_S):
            self.finish()

    def _play(self, records: Iterable[BagRecord], first: float) -> None:
        period = 1.0 / self._settings.clock_rate
        began, ticked = time.monotonic(), 0.0
        for record in records:
            due = began + (record.arrival - first) / self._settings.rate
            while True:
                wall = time.monotonic()
                if wall - ticked >= period:
                    ticked = wall
                    self._tick(min(record.arrival, first + (wall - began) * self._settings.rate))
                if wall >= due:
                    break
                if self._stopping.wait(min(due - wall, ticked + period - wall)):
                    return
            self._outputs[record.name].publish(record.data or record.message)
            self._played += 1
            self._position = record.arrival - first
        self._tick(first + self._position)

    def _static_frames(self, topic: str) -> TFMessage:
        """All static transforms of the bag in one message: a latched topic keeps but one."""
        decode = self._bag.decoder(topic)
        return TFMessage(transforms=list({transform.child_frame_id: transform for _, _, data in self._bag.messages([topic])
                                          for transform in decode(data).transforms}.values()))

    def _tick(self, now: float) -> None:
        self._clock_output.publish(Clock(clock=to_stamp(now)))

    def _wait_for_subscribers(self, first: float) -> None:
        """Until the nodes to wait for listen to something of the bag; the clock stands at its beginning meanwhile."""
        missing = set(filter(None, self._settings.wait_for))
        deadline = time.monotonic() + self._settings.wait_timeout
        while missing and time.monotonic() < deadline and not self._stopping.wait(0.1):
            self._tick(first)
            for publisher in self._outputs.values():
                missing -= {info.node_name for info in self.get_subscriptions_info_by_topic(publisher.topic_name)}
        if missing and not self._stopping.is_set():
            self.get_logger().warning(f'{", ".join(sorted(missing))} did not listen within '
                                      f'{self._settings.wait_timeout:.0f} s: playing nevertheless')
        self._tick(first)
        self._stopping.wait(SETTLE_S)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """How far it is."""
        status.add('bag', self._settings.bag)
        status.add('position', f'{self._position:.1f} of {self._length:.1f} s')
        status.add('messages', str(self._played))
        problems = (*self._bag.problems, *self._feed.problems)
        if problems:
            status.mergeSummary(DiagnosticStatus.WARN, '; '.join(problems))


def main() -> None:
    """Run the node."""
    run(PlayerNode)
