"""Subscribes to bearings and odometry, and publishes commands for gimbal and body within their limits."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import ClassVar

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Odometry
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_msgs.msg import Float32
from std_srvs.srv import SetBool

from av_common.freshness import Instant
from av_common.launched import KeptNumbers
from av_common.node import RigNode, run
from av_common.qos import LATCHED, RESULT
from av_common.rate_meter import RateMeter
from av_common.rig import load_rig
from av_interfaces.msg import Bearing, PointingCommand
from av_pointing.controller import PERIOD_S, Mode
from av_pointing.nodes.pointing_node_parameters import pointing_node as parameters
from av_pointing.stage import make_pointing_stage

PAUSE_S = 1.0  # without a command of a node whose period is PERIOD_S: its process was stopped, and what waits in queues is old
DRAINED_S = 0.5  # after a pause, in which requests that waited are answered


class PointingNode(RigNode):
    """Runs a `PointingStage`."""

    RUNTIME_PARAMETERS: ClassVar[frozenset[str]] = frozenset({'yaw_rate_deg'})

    def __init__(self) -> None:
        super().__init__('pointing_node', parameters)
        # As they were left, also by the process before.
        self._enabled = KeptNumbers(f'{self.get_fully_qualified_name()}.enabled', (self.settings.enabled,), lost=(False,))
        self._angles = KeptNumbers(f'{self.get_fully_qualified_name()}.angles', (0.0, 0.0))

    def configure(self) -> None:
        """Build the stage, open the publisher."""
        self._settings = self.settings
        gimbal = load_rig(self._settings.rig_file).gimbal if self._settings.rig_file else None
        self._stage = make_pointing_stage(self._settings, gimbal)
        self._stage.controller.enabled = self._enabled.values == (True,)
        self._stage.controller.gimbal.start_at(*self._angles.values)
        self._refused = 0
        self._meters = {'bearing': RateMeter(), 'odometry': RateMeter()}
        self._publisher = self.create_publisher(PointingCommand, 'pointing/command', RESULT)

    def activate(self) -> None:
        """Subscribe to fusion and odometry, and start the timer for commands without bearings."""
        self._ran, self._resumed = time.monotonic(), -math.inf
        cues = ['target/cue'] if self._settings.follow_cues else []
        self.refuse_second_publishers('target/bearing', 'odometry', 'yaw_rate_limit', *cues, tell=self._on_publishers,
                                      besides={'target/cue': 'report_node'})    # which has tasks for the rig of a network
        # On the steady clock: a node's clock that is set or stands still must not delay the command to stop.
        self._timer = self.create_steady_timer(PERIOD_S, self._on_time)
        self.create_subscription(Bearing, 'target/bearing', self._on_bearing, RESULT)
        self.subscribe_odometry(self._on_odometry)
        self.create_subscription(Float32, 'yaw_rate_limit', self._stage.on_yaw_rate_limit, LATCHED)
        if cues:
            self.create_subscription(PointStamped, 'target/cue', self._on_cue, RESULT)
        self.create_service(SetBool, '~/enable', self._on_enable)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition, after which the rig moves only when it is enabled again, also by a later process."""
        self._enabled.keep(False)
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition, after which a later process moves nothing, either."""
        self._enabled.keep(False)
        return super().on_shutdown(state)

    def deactivate(self) -> None:
        """Publish a last command that moves nothing."""
        self._stage.controller.enabled = False
        self._publisher.publish(self._stage.on_time(self._instant()))

    def apply_parameters(self) -> None:
        """Use another limit of the yaw rate from the next command on."""
        self._stage.controller.set_yaw_rate(math.radians(self.settings.yaw_rate_deg))

    def _on_publishers(self, contested: Mapping[str, list[str]]) -> None:
        self._stage.contested = contested
        self._stage.on_limiters(self.count_publishers(self.resolve_topic_name('yaw_rate_limit')))

    def _on_bearing(self, message: Bearing) -> None:
        self._meters['bearing'].tick()
        self._publish(self._stage.on_bearing(message, self._instant()))

    def _on_odometry(self, message: Odometry) -> None:
        self._meters['odometry'].tick()
        self._stage.on_odometry(message, self._instant())

    def _on_cue(self, message: PointStamped) -> None:
        self._stage.on_cue(message, self._instant())

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._notice_pause()
        if request.data and self._ran - self._resumed < DRAINED_S:
            response.message = 'this process stood still, and the request may be old: ask again'
            return response
        self._enabled.keep(request.data)
        self._stage.controller.enabled = request.data
        response.success, response.message = True, 'commands move the rig' if request.data else 'commands move nothing'
        return response

    def _on_time(self) -> None:
        self._publish(self._stage.on_time(self._instant()))

    def _notice_pause(self) -> None:
        now = time.monotonic()
        self._resumed = now if now - self._ran > PAUSE_S else self._resumed
        self._ran = now

    def _publish(self, command: PointingCommand) -> None:
        self._notice_pause()
        self._timer.reset()  # the next command follows within one period
        gimbal = self._stage.controller.gimbal
        self._angles.keep(gimbal.pan.position, gimbal.tilt.position)
        self._publisher.publish(command)

    def _instant(self) -> Instant:
        ros = self.now()  # first: a pause of this thread in between makes nothing newer than it is
        return Instant(time.monotonic(), ros)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Report the rates of the inputs and the newest command."""
        if self._meters['bearing'].age > 1.0:
            status.mergeSummary(DiagnosticStatus.WARN, 'no target/bearing')
        if self._settings.move_body and self._meters['odometry'].age > 1.0:
            status.mergeSummary(DiagnosticStatus.WARN, 'no odometry: the body does not move')
        if self._stage.refused > self._refused:
            status.mergeSummary(DiagnosticStatus.WARN, f'{self._stage.refused - self._refused} stamps from the future: are the '
                                'clocks synchronised? Nothing counts as new for 1.1 s after each')
        self._refused = self._stage.refused
        status.add('stamps from the future', str(self._refused))
        for name, meter in self._meters.items():
            status.add(f'{name} rate (Hz)', f'{meter.rate:.1f}')
        status.add('enabled', str(self._stage.controller.enabled))
        status.add('may move', self._stage.controller.may_move)
        if self._settings.move_body:
            self._diagnose_body(status)
        if self._stage.command is not None:
            status.add('mode', f'{Mode(self._stage.command.mode).name}: {self._stage.command.reason}')

    def _diagnose_body(self, status: DiagnosticStatusWrapper) -> None:
        """What is known of the vehicle's answer."""
        body = self._stage.controller.body
        response = body.motion.response
        if body.problem:
            status.mergeSummary(DiagnosticStatus.WARN, body.problem)
        status.add('dead time of the body (s)', f'{response.dead_time:.2f}')
        status.add('lag of the body (s)', f'{response.lag:.2f}')
        status.add('drift of the body (deg/s)', f'{math.degrees(body.motion.drift):.1f}')
        status.add('uncertainty of both (s)', f'{response.uncertainty:.2f}')
        status.add('share of commanded turns that the body made', f'{body.motion.following:.2f}')
        status.add('largest yaw rate (deg/s)', f'{math.degrees(body.limits.rate):.1f}')
        status.add('bandwidth of the body (1/s)', f'{body.bandwidth:.2f}')


def main() -> None:
    """Run the node."""
    run(PointingNode)
