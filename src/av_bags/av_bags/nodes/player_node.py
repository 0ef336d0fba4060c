"""Publishes the messages of a bag and /clock, at the recorded speed or at a multiple of it."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from rosidl_runtime_py.utilities import get_message
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage

from av_bags import topics as names
from av_bags.converters import AudioLayout
from av_bags.definitions import BagError
from av_bags.feed import BagRecord, Feed
from av_bags.nodes.player_node_parameters import player_node as parameters
from av_bags.reader import Bag
from av_bags.topics import STAGES, Found, find_topics, parse_remappings
from av_common.node import RigNode, run
from av_common.qos import LATCHED
from av_common.rig import CAMERAS, camera_topics
from av_common.stamps import to_stamp

# Reliable, and with a queue for bursts, so that replay loses no messages.
PLAYED = QoSProfile(depth=100)
# Time for the other nodes to process the last messages, before the end of this process ends the launch.
LINGER_S = 1.0
# Time between the first and the last subscription of a starting node.
SETTLE_S = 0.5
PAUSE_STEP_S = 0.05  # between looks for the end of a pause
WAIT_S = 30.0  # for the nodes of wait_for
CLOCK_HZ = 100.0  # of /clock
OF_FURTHER_CAMERAS = camera_topics(CAMERAS[1:], *names.OF_CAMERA)


class PlayerNode(RigNode):
    """Plays a bag on a separate thread and ends the process at the end of the bag.

    The service ~/pause holds and continues, the parameter `position` goes to another time; /clock stands still, or jumps. The
    parameter `bag` opens another bag of the folder `bags`, at whose end the player waits.
    """

    RUNTIME_PARAMETERS: ClassVar = frozenset({'position', 'bag'})

    def __init__(self, **kwargs: object) -> None:
        super().__init__('player_node', parameters, **kwargs)

    def configure(self) -> None:
        """Open the bag and the publishers. Raises BagError when there is nothing to play."""
        self._settings = settings = self.settings
        self._layout = AudioLayout(settings.audio_rate, settings.audio_channels, settings.audio_format)\
            if settings.audio_rate else None
        if not settings.bag:
            raise BagError('bag is empty, expected a file or folder to play')
        self._open(settings.bag, settings.position)
        played = self._wanted() if settings.bags else self._topics
        self._outputs = {name: self.create_publisher(get_message(names.KINDS[name][0]), name, PLAYED)
                         for name in played if name != names.FRAMES}
        self._clock_output = self.create_publisher(Clock, '/clock', 10)
        self._played = 0

    def _open(self, path: str, position: float) -> None:
        """Open a bag at a position (s). Raises BagError when there is nothing to play."""
        settings, bag = self._settings, Bag(path)
        found = self._find(bag)
        for name, reason in found.missing.items():
            if name in found.unused or name not in OF_FURTHER_CAMERAS:  # most rigs have one camera
                self.get_logger().info(reason)
        self._stop = position + settings.duration if settings.duration else math.inf
        self._static_topic = found.topics.pop(names.FRAMES, None)
        self._bag, self._path, self._topics = bag, path, found.topics
        self._feed = self._feed_from(position)
        self._length = min(self._stop, bag.length)
        self._position = self._wanted_position = position
        self._seek = False

    def _find(self, bag: Bag) -> Found:
        """The topics of a bag that are played. Raises BagError where there are none."""
        settings = self._settings
        found = find_topics(bag, self._wanted(), parse_remappings(settings.remap), settings.recorded_namespace)
        if not found.topics:
            raise BagError(f'{bag.path} has nothing to play for only={settings.only}: {"; ".join(found.missing.values())}')
        return found

    @staticmethod
    def check_parameters(settings: Any) -> None:
        """Each remapping must be one, of a name that is played."""
        parse_remappings(settings.remap)

    def _wanted(self) -> list[str]:
        detected = self._settings.only == 'raw' and not self._settings.detections
        omitted = camera_topics(CAMERAS, names.DETECTIONS, names.VISIBILITY) if detected else ()
        return [name for name in STAGES[self._settings.only] if name not in omitted]

    def activate(self) -> None:
        """Publish the static transforms and start to play."""
        self._frames_output = self.create_publisher(TFMessage, names.FRAMES, LATCHED)
        self._stopping, self._paused = threading.Event(), threading.Event()
        self.create_service(SetBool, '~/pause', self._on_pause)
        self._start()

    def _start(self) -> None:
        if self._static_topic is not None:
            self._frames_output.publish(self._static_transforms(self._static_topic))
        self._stopping.clear()
        self._thread = threading.Thread(target=self._run, name='play', daemon=True)
        self._thread.start()

    def deactivate(self) -> None:
        """Stop playing."""
        self._stopping.set()
        self._thread.join()

    def cleanup(self) -> None:
        """Close the bag."""
        self._bag.close()

    def check_change(self, settings: Any) -> None:
        """The position must be within the bag, another bag within the folder and playable."""
        if settings.bag != self._path:
            if not settings.bags or Path(settings.bag).resolve().parent != Path(settings.bags).resolve():
                raise ValueError(f'bag is {settings.bag}, expected a bag of the folder bags: {settings.bags or "none is set"}')
            with Bag(settings.bag) as bag:
                Feed(bag, self._find(bag).topics, self._layout)    # raises BagError where a topic cannot be read
        elif settings.position > self._length:
            raise ValueError(f'position is {settings.position}, expected at most {self._length:.1f}, the length of the bag (s)')

    def apply_parameters(self) -> None:
        """Open another bag, or go to another position."""
        if self.settings.bag == self._path:
            self._wanted_position, self._seek = self.settings.position, True
            return
        playing = self.is_active
        if playing:
            self.deactivate()
        self._bag.close()
        self._open(self.settings.bag, 0.0)
        if playing:
            self._start()

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._paused.set() if request.data else self._paused.clear()
        response.success, response.message = True, 'paused' if request.data else 'playing'
        return response

    def _feed_from(self, position: float) -> Feed:
        """What is played from a time (s) after the start on. Raises BagError where a topic cannot be read."""
        return Feed(self._bag, self._topics, self._layout, position, self._stop, decode=False)

    def _run(self) -> None:
        waited = False
        while True:
            try:
                records = iter(self._feed)
                first = next(records, None)
                if first is not None:
                    if not waited:
                        self._wait_for_subscribers(first.arrival)
                        waited = True
                    self._play(chain([first], records))
            except Exception as error:  # noqa: BLE001  such as times that no clock of a node can show
                self.refused.refuse('bag', error)
            while self._settings.bags and not self._seek and not self._stopping.wait(PAUSE_STEP_S):
                pass
            if not self._seek or self._stopping.is_set():
                break
            self._seek, self._position = False, self._wanted_position
            self._feed = self._feed_from(self._wanted_position)
        for note in (*self._bag.notes, *self._feed.notes):
            self.get_logger().warning(note)
        for problem in (*self._bag.problems, *self._feed.lost):
            self.get_logger().error(problem)
        self.get_logger().info(f'played {self._played} messages, {self._position:.1f} s')
        if not self._stopping.wait(LINGER_S):
            self.finish()

    def _play(self, records: Iterable[BagRecord]) -> None:
        """Publish the records when they are due, and /clock in between. Between segments it leaps, as the clock did."""
        period, rate = 1.0 / CLOCK_HZ, self._settings.rate
        began, ticked = time.monotonic(), 0.0
        first, segment, start = math.nan, -1, self._position
        for record in records:
            if record.segment != segment:
                first, segment, start, began = record.arrival, record.segment, self._position, time.monotonic()
            while True:
                began += self._pause()
                due = began + (record.arrival - first) / rate
                wall = time.monotonic()
                if wall - ticked >= period:
                    ticked = wall
                    self._publish_clock(min(record.arrival, first + (wall - began) * rate))
                if wall >= due:
                    break
                if self._stopping.wait(min(due - wall, ticked + period - wall)) or self._seek:
                    return
            self._outputs[record.name].publish(record.data or record.message)
            self._played += 1
            self._position = start + record.arrival - first
        if segment >= 0:
            self._publish_clock(first + self._position - start)

    def _pause(self) -> float:
        """Wait while the player is paused; returns how long that was (s)."""
        began = time.monotonic()
        while self._paused.is_set() and not self._seek and not self._stopping.wait(PAUSE_STEP_S):
            pass
        return time.monotonic() - began

    def _static_transforms(self, topic: str) -> TFMessage:
        """All static transforms of the bag in one message, because subscribers receive only the last latched one."""
        feed = Feed(self._bag, {names.FRAMES: topic})
        found = {transform.child_frame_id: transform for record in feed for transform in record.message.transforms}
        for problem in feed.lost:
            self.get_logger().error(problem)
        return TFMessage(transforms=list(found.values()))

    def _publish_clock(self, now: float) -> None:
        self._clock_output.publish(Clock(clock=to_stamp(now)))

    def _wait_for_subscribers(self, first: float) -> None:
        """Wait until the nodes of `wait_for` have subscribed; /clock stays at the time `first` (s) meanwhile."""
        missing = set(filter(None, self._settings.wait_for))
        deadline = time.monotonic() + WAIT_S
        while missing and time.monotonic() < deadline and not self._stopping.wait(0.1):
            self._publish_clock(first)
            for publisher in self._outputs.values():
                missing -= {info.node_name for info in self.get_subscriptions_info_by_topic(publisher.topic_name)}
        if missing and not self._stopping.is_set():
            self.get_logger().warning(f'{", ".join(sorted(missing))} did not subscribe within '
                                      f'{WAIT_S:.0f} s; starting without')
        self._publish_clock(first)
        self._stopping.wait(SETTLE_S)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Report the position in the bag and the problems so far."""
        status.add('bag', self._path)
        status.add('position', f'{self._position:.1f} of {self._length:.1f} s')
        status.add('paused', str(self._paused.is_set()))
        status.add('messages', str(self._played))
        problems = (*self._bag.problems, *self._feed.lost)
        if problems:
            status.mergeSummary(DiagnosticStatus.WARN, '; '.join(problems))


def main() -> None:
    """Run the node."""
    run(PlayerNode)
