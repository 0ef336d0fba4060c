"""A bearing in; a command for gimbal and body out, limited and safe to obey."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from std_msgs.msg import Header
from std_srvs.srv import SetBool

from av_common.node import RigNode, run
from av_common.qos import RESULT
from av_common.rate_meter import RateMeter
from av_common.stamps import to_stamp
from av_common.track import Track
from av_common.track_messages import track_of_bearing
from av_interfaces.msg import Bearing, PointingCommand
from av_pointing.controller import Command, PointingController
from av_pointing.nodes.pointing_node_parameters import pointing_node as parameters
from av_pointing.settings import pointing_settings


class PointingNode(RigNode):
    """Thin shell around the pointing controller."""

    def __init__(self) -> None:
        super().__init__('pointing_node', parameters)

    def configure(self) -> None:
        """Build the controller, open the publisher."""
        self._settings = self.settings
        self._controller = PointingController(pointing_settings(self._settings))
        self._controller.enabled = self._settings.enabled
        self._track: Track | None = None
        self._command: Command | None = None
        self._meter = RateMeter()
        self._last_step = -math.inf
        self._publisher = self.create_publisher(PointingCommand, 'pointing/command', RESULT)

    def activate(self) -> None:
        """Listen to the fusion and step even when it is silent."""
        self.while_active(self.create_subscription, Bearing, 'target/bearing', self._on_bearing, RESULT)
        self.while_active(self.create_service, SetBool, '~/enable', self._on_enable)
        self.while_active(self.create_timer, 1.0 / self._settings.rate, self._on_timer)

    def deactivate(self) -> None:
        """Leave with a command that moves nothing."""
        self._controller.enabled = False
        self._step(self.now())

    def cleanup(self) -> None:
        """Close the publisher."""
        self.destroy_publisher(self._publisher)

    def _on_bearing(self, message: Bearing) -> None:
        self._meter.tick()
        self._track = track_of_bearing(message)
        self._step(self.now())

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._controller.enabled = request.data
        response.success, response.message = True, 'commands move the rig' if request.data else 'commands move nothing'
        return response

    def _on_timer(self) -> None:
        now = self.now()
        if now - self._last_step > 0.9 / self._settings.rate:
            self._step(now)

    def _step(self, now: float) -> None:
        self._last_step = now
        self._command = command = self._controller.step(now, self._track)
        self._publisher.publish(PointingCommand(
            header=Header(stamp=to_stamp(now), frame_id=self._settings.base_frame), mode=int(command.mode),
            reason=command.reason, move_gimbal=command.move_gimbal, pan=command.pan, tilt=command.tilt,
            pan_rate=command.pan_rate, tilt_rate=command.tilt_rate, move_body=command.move_body,
            yaw_rate=command.yaw_rate))

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Whether bearings come and what is commanded."""
        if self._meter.age > 1.0:
            status.mergeSummary(DiagnosticStatus.WARN, 'no target/bearing')
        status.add('bearing rate (Hz)', f'{self._meter.rate:.1f}')
        status.add('enabled', str(self._controller.enabled))
        if self._command is not None:
            status.add('mode', f'{self._command.mode.name}: {self._command.reason}')


def main() -> None:
    """Run the node."""
    run(PointingNode)
