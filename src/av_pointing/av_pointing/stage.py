"""The pointing stage: bearings and their times of arrival in, commands for gimbal and body out."""

from __future__ import annotations

from typing import Any

from std_msgs.msg import Header

from av_common.stamps import to_stamp
from av_common.track import Track
from av_common.track_messages import track_of_bearing
from av_interfaces.msg import Bearing, PointingCommand
from av_pointing.controller import Command, PointingController
from av_pointing.settings import pointing_settings


class PointingStage:
    """Gives a command for each bearing, and at any time by `on_time`. Times are in s of one clock.

    Attributes:
        controller: computes the commands; `controller.enabled` decides whether they move anything.
        command: the newest command, None before the first.

    Parameters:
        controller: see the attribute.
        base_frame: frame of the rig's body, in which commands are given.
    """

    def __init__(self, controller: PointingController, base_frame: str = 'base_link') -> None:
        self.controller = controller
        self.command: Command | None = None
        self._base_frame = base_frame
        self._track: Track | None = None

    def on_bearing(self, message: Bearing, arrival: float) -> PointingCommand:
        """The command that follows from a bearing.

        Parameters:
            message: the bearing.
            arrival (s): time of its arrival.
        """
        self._track = track_of_bearing(message)
        return self.on_time(arrival)

    def on_time(self, now: float) -> PointingCommand:
        """The command at `now`, from the newest bearing while it is not stale."""
        self.command = self.controller.step(now, self._track)
        return command_message(self.command, now, self._base_frame)


def command_message(command: Command, time: float, frame_id: str) -> PointingCommand:
    """A command as message, valid at `time` (s) in the body frame `frame_id`.

    Parameters:
        command: the command.
        time (s): time for which it is valid.
        frame_id: frame of the rig's body.
    """
    return PointingCommand(
        header=Header(stamp=to_stamp(time), frame_id=frame_id), mode=int(command.mode), reason=command.reason,
        move_gimbal=command.move_gimbal, pan=command.pan, tilt=command.tilt, pan_rate=command.pan_rate,
        tilt_rate=command.tilt_rate, move_body=command.move_body, yaw_rate=command.yaw_rate)


def make_pointing_stage(parameters: Any) -> PointingStage:
    """A stage from the parameters of pointing_node. Raises ValueError for stops that exclude 0."""
    controller = PointingController(pointing_settings(parameters))
    controller.enabled = parameters.enabled
    return PointingStage(controller, parameters.base_frame)
