"""What others ask of the rig, as calls and messages to its nodes."""

from __future__ import annotations

import math
from collections.abc import Callable

from geometry_msgs.msg import Point, PointStamped
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Header

from av_common.angles import angles_to_direction
from av_common.frames import BASE_FRAME
from av_common.qos import RESULT
from av_common.stamps import to_stamp
from av_interfaces.srv import SelectTarget
from av_reports.contacts import Command, Follow, LookAt

CUE_TOPIC, SELECT = 'target/cue', 'fusion_node/select'
WORLD = 'world'  # frame of cues with a heading: at the rig, x to the east and y to the north
FAR_M = 1000.0  # a direction has no distance
BY_POLICY = 0  # id that leaves the choice to the tracker


class RigCommands:
    """Has the rig follow a target, or look in a direction, by its tracker's service and by cues. It moves nothing by itself.

    Parameters:
        node: owner of client and publisher.
        tracks_alone: whether the targets that are reported are those of the tracker.
        now: function that returns ROS time in s.
    """

    def __init__(self, node: Node, tracks_alone: bool, now: Callable[[], float]) -> None:
        self._tracks_alone = tracks_alone
        self._select = node.create_client(SelectTarget, SELECT)
        self._cues = node.create_publisher(PointStamped, CUE_TOPIC, RESULT)
        self._now = now
        self._cue: LookAt | None = None
        self._following = False
        self._asked: Future | None = None  # of the tracker, which has not answered yet

    def perform(self, command: Command, done: Callable[[str], None]) -> None:
        """Begin a command. One that cannot be done changes nothing.

        Parameters:
            command: what to do.
            done: called with the reason why it cannot be done, or an empty one when it has begun.
        """
        if isinstance(command, Follow):
            self._follow(command.id, done)
        elif isinstance(command, LookAt) and self._cues.get_subscription_count() == 0:
            done('nothing on this rig takes cues')
        else:
            self._release()
            self._cue = command if isinstance(command, LookAt) else None
            self.repeat()
            done('')

    def repeat(self) -> None:
        """Publish the cue again while there is one, so that it cannot be obeyed when this node has gone."""
        if self._cue is not None:
            header = Header(stamp=to_stamp(self._now()), frame_id=WORLD if self._cue.north else BASE_FRAME)
            turn = math.pi / 2 - self._cue.azimuth if self._cue.north else -self._cue.azimuth
            x, y, z = map(float, FAR_M * angles_to_direction(turn, self._cue.elevation))
            self._cues.publish(PointStamped(header=header, point=Point(x=x, y=y, z=z)))

    def _follow(self, target: int, done: Callable[[str], None]) -> None:
        if not self._tracks_alone:
            done('the targets of a network are not those of the tracker')
            return
        if not self._select.service_is_ready():
            done(f'the tracker does not answer: there is no service {self._select.srv_name}')
            return

        def answered(future: Future) -> None:
            answer = future.result()
            if future is self._asked:  # else another command has come since
                self._asked = None
                if answer.success:
                    self._following, self._cue = True, None
            done('' if answer.success else answer.message or 'the tracker refuses')
        self._asked = self._select.call_async(SelectTarget.Request(id=target))
        self._asked.add_done_callback(answered)

    def _release(self) -> None:
        """Leave the choice to the tracker, which answers in order: also after what it has not answered yet."""
        if (self._following or self._asked) and self._select.service_is_ready():
            self._select.call_async(SelectTarget.Request(id=BY_POLICY))
        self._following, self._asked = False, None
