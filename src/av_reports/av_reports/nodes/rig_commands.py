"""What others ask of the rig, as calls and messages to its nodes."""

from __future__ import annotations

import math
from collections.abc import Callable

from geometry_msgs.msg import Vector3, Vector3Stamped
from rclpy.node import Node
from rclpy.task import Future

from av_common.qos import RESULT
from av_common.stamps import to_stamp
from av_interfaces.srv import SelectTarget
from av_reports.tasking import Command, Follow, LookAt

CUE_TOPIC = 'target/cue'
BY_POLICY = 0  # id that leaves the choice to the tracker


class RigCommands:
    """Has the rig follow a target, or look in a direction, by its tracker's service and by cues. It moves nothing by itself.

    Parameters:
        node: owner of client and publisher.
        tracker: name of the node that follows targets.
        frames: of the world (x to the east, y to the north) and of the rig's body.
        now: function that returns ROS time in s.
    """

    def __init__(self, node: Node, tracker: str, frames: tuple[str, str], now: Callable[[], float]) -> None:
        self._select = node.create_client(SelectTarget, f'{tracker}/select')
        self._cues = node.create_publisher(Vector3Stamped, CUE_TOPIC, RESULT)
        self._frames, self._now = frames, now
        self._cue: LookAt | None = None
        self._following = False

    def perform(self, command: Command, done: Callable[[str], None]) -> None:
        """Begin a command.

        Parameters:
            command: what to do.
            done: called with the reason why it cannot be done, or an empty one when it has begun.
        """
        self._cue = None
        if isinstance(command, Follow):
            self._follow(command.id, done)
            return
        self._release()
        if isinstance(command, LookAt):
            if self._cues.get_subscription_count() == 0:
                done('nothing on this rig takes cues')
                return
            self._cue = command
            self.repeat()
        done('')

    def repeat(self) -> None:
        """Publish the cue again while there is one, so that it cannot be obeyed when this node has gone."""
        if self._cue is not None:
            self._cues.publish(Vector3Stamped(header=self._header(self._cue), vector=direction(self._cue)))

    def _header(self, cue: LookAt) -> object:
        message = Vector3Stamped()
        message.header.stamp, message.header.frame_id = to_stamp(self._now()), self._frames[0 if cue.north else 1]
        return message.header

    def _follow(self, target: int, done: Callable[[str], None]) -> None:
        if not self._select.service_is_ready():
            done(f'the tracker does not answer: there is no service {self._select.srv_name}')
            return

        def answered(future: Future) -> None:
            answer = future.result()
            self._following = answer is not None and answer.success
            done('' if self._following else answer.message if answer is not None else 'the tracker does not answer')
        self._select.call_async(SelectTarget.Request(id=target)).add_done_callback(answered)

    def _release(self) -> None:
        if self._following and self._select.service_is_ready():
            self._select.call_async(SelectTarget.Request(id=BY_POLICY))
        self._following = False


def direction(cue: LookAt) -> Vector3:
    """Unit vector of a cue: x to the east and y to the north, or x ahead and y to the left."""
    turn = math.pi / 2 - cue.azimuth if cue.north else -cue.azimuth
    across = math.cos(cue.elevation)
    return Vector3(x=across * math.cos(turn), y=across * math.sin(turn), z=math.sin(cue.elevation))
