"""Subscribes to bearings and publishes commands for gimbal and body within their limits."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from std_srvs.srv import SetBool

from av_common.node import RigNode, run
from av_common.qos import RESULT
from av_common.rate_meter import RateMeter
from av_interfaces.msg import Bearing, PointingCommand
from av_pointing.nodes.pointing_node_parameters import pointing_node as parameters
from av_pointing.stage import make_pointing_stage


class PointingNode(RigNode):
    """Runs a `PointingStage`."""

    def __init__(self) -> None:
        super().__init__('pointing_node', parameters)

    def configure(self) -> None:
        """Build the stage, open the publisher."""
        self._settings = self.settings
        self._stage = make_pointing_stage(self._settings)
        self._meter = RateMeter()
        self._last_command = -math.inf
        self._publisher = self.create_publisher(PointingCommand, 'pointing/command', RESULT)

    def activate(self) -> None:
        """Subscribe to the fusion, and start the timer for commands without bearings."""
        self.while_active(self.create_subscription, Bearing, 'target/bearing', self._on_bearing, RESULT)
        self.while_active(self.create_service, SetBool, '~/enable', self._on_enable)
        self.while_active(self.create_timer, 1.0 / self._settings.rate, self._on_time)

    def deactivate(self) -> None:
        """Publish a last command that moves nothing."""
        self._stage.controller.enabled = False
        now = self.now()
        self._publish(self._stage.on_time(now), now)

    def cleanup(self) -> None:
        """Close the publisher."""
        self.destroy_publisher(self._publisher)

    def _on_bearing(self, message: Bearing) -> None:
        self._meter.tick()
        now = self.now()
        self._publish(self._stage.on_bearing(message, now), now)

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._stage.controller.enabled = request.data
        response.success, response.message = True, 'commands move the rig' if request.data else 'commands move nothing'
        return response

    def _on_time(self) -> None:
        now = self.now()
        if now - self._last_command > 0.9 / self._settings.rate:
            self._publish(self._stage.on_time(now), now)

    def _publish(self, command: PointingCommand, now: float) -> None:
        self._last_command = now
        self._publisher.publish(command)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Report the rate of bearings and the newest command."""
        if self._meter.age > 1.0:
            status.mergeSummary(DiagnosticStatus.WARN, 'no target/bearing')
        status.add('bearing rate (Hz)', f'{self._meter.rate:.1f}')
        status.add('enabled', str(self._stage.controller.enabled))
        if self._stage.command is not None:
            status.add('mode', f'{self._stage.command.mode.name}: {self._stage.command.reason}')


def main() -> None:
    """Run the node."""
    run(PointingNode)
