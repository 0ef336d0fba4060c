"""Node between the rig and PX4: pointing commands to its gimbal and body, its pose as the rig's odometry."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from nav_msgs.msg import Odometry
from std_msgs.msg import Float32, Float32MultiArray

from av_common.freshness import Instant
from av_common.launched import KeptNumbers
from av_common.node import RigNode, run
from av_common.qos import LATCHED, RESULT, STREAM
from av_common.rig import load_rig
from av_interfaces.msg import Bearing, GimbalState, PointingCommand
from av_px4.external_mode import Registration
from av_px4.gimbal import Claim
from av_px4.guard import STATUS_TIMEOUT
from av_px4.nodes.px4_link import Px4Link
from av_px4.nodes.px4_node_parameters import px4_node as parameters
from av_px4.stage import (
    GIMBAL_TOPIC,
    HEARTBEAT,
    MOTORS_TOPIC,
    ODOMETRY_TOPIC,
    RATE_HZ,
    STATE_TOPIC,
    Outgoing,
    Px4Stage,
)

OUTPUTS = {'vehicle_status': 'VehicleStatus', 'vehicle_odometry': 'VehicleOdometry', 'esc_status': 'EscStatus',
           'vehicle_local_position': 'VehicleLocalPosition', 'vehicle_command_ack': 'VehicleCommandAck',
           'gimbal_device_attitude_status': 'GimbalDeviceAttitudeStatus', 'actuator_motors': 'ActuatorMotors'}
MODE_OUTPUTS = {'register_ext_component_reply': 'RegisterExtComponentReply', 'arming_check_request': 'ArmingCheckRequest',
                'setpoint_config_reply': 'SetpointConfigReply'}
MODE_INPUTS = {'register_ext_component_request': 'RegisterExtComponentRequest',
               'unregister_ext_component': 'UnregisterExtComponent', 'arming_check_reply': 'ArmingCheckReply'}
LIMIT_TOPIC = 'yaw_rate_limit'
DISCOVERY_S, WATCH_S = 0.5, 0.1    # periods of the search for topics, and of the look for others that steer the vehicle
NO_MODE = (-1, -1)    # numbers that no registration has
# What stops the vehicle is sent repeatedly: PX4 reads without acknowledgement, and nothing follows.
LAST_SENT, LAST_PERIOD_S = 3, 0.02


class Px4Node(RigNode):
    """Topics, timers and diagnostics of Px4Stage, which makes all decisions."""

    def __init__(self) -> None:
        super().__init__('px4_node', parameters)
        self._kept_mode = KeptNumbers(f'{self.get_fully_qualified_name()}.external_mode', NO_MODE)

    def configure(self) -> None:
        """Create the stage and the publishers. Raises ImportError without px4_msgs."""
        self._settings = self.settings
        self._link = Px4Link(self)
        gimbal = load_rig(self._settings.rig_file).gimbal if self._settings.rig_file else None
        self._stage = Px4Stage(self._settings, self._link.messages, gimbal)
        for name, kind in (OUTPUTS | (MODE_OUTPUTS if self._stage.mode else {})).items():
            self._link.subscribe(name, kind, partial(self._take, getattr(self._stage, f'on_{name}')))
        for name, kind in self._inputs().items():
            self._link.advertise(name, kind)
        self._undated = 0
        self._outputs = {ODOMETRY_TOPIC: self.create_publisher(Odometry, ODOMETRY_TOPIC, RESULT),
                         STATE_TOPIC: self.create_publisher(DiagnosticStatus, STATE_TOPIC, LATCHED),
                         GIMBAL_TOPIC: self.create_publisher(GimbalState, GIMBAL_TOPIC, STREAM)}
        self._limit = self.create_publisher(Float32, LIMIT_TOPIC, LATCHED)

    def activate(self) -> None:
        """Subscribe to the rig's topics and search for PX4's."""
        check, mode = map(int, self._kept_mode.values)
        former = Registration(check, mode) if (check, mode) != NO_MODE else None
        self._stage.start(self._instant(), former)
        for kind, topic, take in ((PointingCommand, 'pointing/command', self._stage.on_command),
                                  (Bearing, 'target/bearing', self._stage.on_bearing)):
            self.create_subscription(kind, topic, partial(self._take, take), RESULT)
        self.create_steady_timer(1.0 / RATE_HZ, self._on_timer)
        self.refuse_second_publishers('pointing/command', 'target/bearing', tell=partial(setattr, self._stage, 'contested'))
        self.create_steady_timer(DISCOVERY_S, self._discover)
        self.create_steady_timer(WATCH_S, self._watch)
        self._discover()
        self._watch()

    def deactivate(self) -> None:
        """Stop the vehicle's motion, release the gimbal and unregister the mode."""
        last = self._stage.stop(self._instant())
        for _ in range(LAST_SENT):
            self._send(last)
            time.sleep(LAST_PERIOD_S)
        if not (self._stage.mode and self._stage.mode.registration):
            self._kept_mode.keep(*NO_MODE)
        self._outputs.pop(MOTORS_TOPIC, None)
        self._link.close()

    def _inputs(self) -> dict[str, str]:
        """PX4's inputs that this node writes, with their messages: only those that it needs, as others look at the graph."""
        p, names = self._settings, {'vehicle_command': 'VehicleCommand'}
        if p.turn_body and (p.offboard or self._stage.mode):
            names['trajectory_setpoint'] = 'TrajectorySetpoint'
        if p.turn_body and p.offboard:
            names[HEARTBEAT] = 'OffboardControlMode'
        if self._stage.mode:
            newer = hasattr(self._link.messages, 'SetpointConfig')
            names |= MODE_INPUTS | ({'setpoint_config': 'SetpointConfig'} if newer else
                                    {'config_control_setpoints': 'VehicleControlMode'})
        return names

    def _discover(self) -> None:
        self._limit.publish(Float32(data=self._stage.max_rate))    # repeatedly: it ends with any other publisher
        self._link.discover()
        self._stage.unused = {name for name in self._inputs() if not self._link.reads(name)} | {
            name for name in MODE_OUTPUTS if not self._link.sends(name)}

    def _watch(self) -> None:
        self._stage.others = self._link.others()
        self._link.ask()

    def _instant(self) -> Instant:
        return Instant(time.monotonic(), self.now())

    def _take(self, take: Callable[[Any, Instant], list[Outgoing]], message: Any) -> None:
        self._send(take(message, self._instant()))

    def _on_timer(self) -> None:
        self._send(self._stage.on_time(self._instant()))
        registration = self._stage.mode and self._stage.mode.registration
        if registration and (registration.arming_check_id, registration.mode_id) != self._kept_mode.values:
            self._kept_mode.keep(registration.arming_check_id, registration.mode_id)

    def _send(self, messages: list[Outgoing]) -> None:
        for topic, message in messages:
            if topic == MOTORS_TOPIC and topic not in self._outputs:    # else it would seem to be a second source
                self._outputs[topic] = self.create_publisher(Float32MultiArray, topic, STREAM)
            if topic in self._outputs:
                self._outputs[topic].publish(message)
            else:
                self._link.publish(topic, message)

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """Report missing inputs, the gimbal's state and the reason of the guard's decision."""
        stage = self._stage
        stage.advance(self._instant())
        for problem in self._problems():
            status.mergeSummary(DiagnosticStatus.WARN, problem)
        for name, meter in stage.meters.items():
            status.add(f'{name} rate (Hz)', f'{meter.rate:.1f}')
        status.add('gimbal', stage.gimbal.state)
        status.add('gimbal takeovers', str(stage.gimbal.takeovers))
        status.add('last acknowledgement', stage.gimbal.last_result)
        status.add('body', stage.decision.reason)
        status.add('others that steer the vehicle', stage.others)
        status.add('OFFBOARD withheld', stage.offboard_withheld)
        status.add('own mode withheld', stage.mode_withheld)
        status.add('heading and position resets', str(stage.pose.resets))
        status.add('clock restarts', str(stage.clock.restarts))
        status.add('odometry undated', str(stage.clock.refused))

    def _problems(self) -> list[str]:
        gimbal, mode = self._stage.gimbal, self._stage.mode
        found = [*self._link.problems.values(), mode.problem if mode else '']
        if self._stage.clock.refused > self._undated:
            found.append("poses that cannot be dated: PX4's clock has jumped, see UXRCE_DDS_SYNCT")
        self._undated = self._stage.clock.refused
        if self._link.topic('vehicle_status') is None and 'vehicle_status' not in self._link.problems:
            found.append('no topics of PX4: is MicroXRCEAgent running, and UXRCE_DDS_CFG set?')
        elif self._stage.meters['status'].age > STATUS_TIMEOUT:
            found.append('no fresh vehicle_status')
        elif self._settings.turn_body and self._stage.others:
            found.append(f'the body is not turned: {self._stage.others}')
        elif self._settings.turn_body and self._settings.external_mode and self._stage.mode_missing:
            found.append(self._stage.mode_missing)
        if self._settings.gimbal.enabled and gimbal.claim is Claim.ASKED and not gimbal.last_result:
            found.append('the claim of the gimbal is not acknowledged: is MNT_MODE_IN 4 or 0, and has PX4 been restarted since '
                         'it was set? It takes effect at boot only (SITL: PX4_PARAM_MNT_MODE_IN=4)'
                         if self._link.topic('vehicle_command_ack') else
                         'no vehicle_command_ack: add it to dds_topics.yaml (PX4 1.14), or set gimbal.need_ack to false')
        if gimbal.unacknowledged:
            found.append('commands are no longer acknowledged')
        return [problem for problem in found if problem]


def main() -> None:
    """Run the node."""
    run(Px4Node)
