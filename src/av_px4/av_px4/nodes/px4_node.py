"""The pointing command to PX4's gimbal and body, PX4's attitude to the rig's odometry. What may be sent, the guard decides."""

from __future__ import annotations

import math
import time
from typing import Any, ClassVar

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from diagnostic_updater import DiagnosticStatusWrapper

from av_common.frames import attitude_ned_to_enu
from av_common.node import RigNode, run
from av_common.qos import LATCHED, RESULT
from av_common.rate_meter import RateMeter
from av_common.stamps import to_seconds
from av_interfaces.msg import Bearing, PointingCommand
from av_px4.continuity import HeldPosition
from av_px4.external_mode import ExternalMode
from av_px4.frames import levelled, pose_from_px4
from av_px4.gimbal import Claim, Gimbal, GimbalInputs
from av_px4.guard import BodyGuard, Decision, Inputs, VehicleStatus
from av_px4.nodes import px4_messages as px4
from av_px4.nodes.px4_link import Px4Link
from av_px4.nodes.px4_node_parameters import px4_node as parameters
from av_px4.nodes.px4_odometry import OdometryRelay
from av_px4.nodes.px4_settings import gimbal_settings, guard_settings

STREAMS = ('status', 'attitude', 'odometry', 'position', 'command', 'bearing')
OUTPUTS = {'vehicle_status': 'VehicleStatus', 'vehicle_attitude': 'VehicleAttitude', 'vehicle_odometry': 'VehicleOdometry',
           'vehicle_local_position': 'VehicleLocalPosition', 'vehicle_command_ack': 'VehicleCommandAck',
           'gimbal_device_attitude_status': 'GimbalDeviceAttitudeStatus',
           'register_ext_component_reply': 'RegisterExtComponentReply', 'arming_check_request': 'ArmingCheckRequest'}
INPUTS = {'vehicle_command': 'VehicleCommand', 'offboard_control_mode': 'OffboardControlMode',
          'trajectory_setpoint': 'TrajectorySetpoint'}
MODE_INPUTS = {'register_ext_component_request': 'RegisterExtComponentRequest',
               'unregister_ext_component': 'UnregisterExtComponent', 'arming_check_reply': 'ArmingCheckReply',
               'config_control_setpoints': 'VehicleControlMode'}


class Px4Node(RigNode):
    """Thin shell around the guard, the gimbal's client and the external mode."""

    RENAMED_PARAMETERS: ClassVar[dict[str, str]] = {
        'simulator_port': 'follow_odometry, of bridge_node', 'simulator_host': 'control_host, of bridge_node'}

    def __init__(self) -> None:
        super().__init__('px4_node', parameters)

    def configure(self) -> None:
        """Build what decides. Raises ImportError without px4_msgs."""
        self._settings = self.settings
        self._link = Px4Link(self, self._settings.fmu)
        self._guard, self._gimbal = BodyGuard(guard_settings(self._settings)), Gimbal(gimbal_settings(self._settings))
        for name, message in OUTPUTS.items():
            self._link.listen(name, message, getattr(self, f'_on_{name}'))
        inputs = INPUTS | (MODE_INPUTS if self._settings.external_mode else {})
        for name, message in inputs.items():
            self._link.speak(name, message)
        self._mode: ExternalMode | None = None
        if self._settings.external_mode:
            if not self._link.has(*MODE_INPUTS.values()):
                raise ImportError('external_mode: the installed px4_msgs has no messages for it (PX4 1.15 and later have)')
            self._mode = ExternalMode(self._settings.external_mode_name)
        self._meters = {name: RateMeter() for name in STREAMS}
        self._place = HeldPosition()
        self._status: VehicleStatus | None = None
        self._attitude: Any = None
        self._measured: tuple[float, float] | None = None
        self._command = PointingCommand()
        self._decision = Decision(False, False, 0.0, 'not started')
        self._complaint, self._last_step, self._reported = '', -math.inf, ()
        self._odometry = OdometryRelay(self, self._settings.odom_frame, self._settings.base_frame)
        self._state = self.create_publisher(DiagnosticStatus, 'px4/state', LATCHED)

    def activate(self) -> None:
        """Listen to the rig and look for PX4."""
        self._activated = time.monotonic()
        self.while_active(self.create_subscription, PointingCommand, 'pointing/command', self._on_command, RESULT)
        self.while_active(self.create_subscription, Bearing, 'target/bearing', self._on_bearing, RESULT)
        self.while_active(self.create_timer, 1.0 / self._settings.rate, self._on_timer)
        self.while_active(self.create_timer, 0.5, self._link.discover)
        self._link.discover()

    def deactivate(self) -> None:
        """Leave the vehicle still, give back the gimbal and the mode."""
        if self._decision.setpoint:
            self._send_setpoint(0.0)
        self._send_commands(self._gimbal.release(self._status.system_id if self._status else 1))
        if self._mode and self._mode.registration:
            self._link.publish('unregister_ext_component', px4.unregister_message(
                self._link.messages, self._timestamp(), self._mode.registration))
            self._mode.forget('stopped')
        self._link.close()

    def cleanup(self) -> None:
        """Close the publishers."""
        self._odometry.close()
        self.destroy_publisher(self._state)

    def _timestamp(self) -> int:
        return self.get_clock().now().nanoseconds // 1000

    # from the rig

    def _on_command(self, message: PointingCommand) -> None:
        if self._in_time(message.header.stamp, self._settings.timeouts.command):
            self._meters['command'].tick()
            self._command = message
            self._step()

    def _on_bearing(self, message: Bearing) -> None:
        if message.state != Bearing.STATE_NONE and self._in_time(message.header.stamp, self._settings.timeouts.bearing):
            self._meters['bearing'].tick()

    def _in_time(self, stamp: Time, limit: float) -> bool:
        """Whether a message is not itself late: one that waited in a queue is not fresh because it arrives now."""
        return abs(self.now() - to_seconds(stamp)) <= limit

    # from PX4

    def _on_vehicle_status(self, message: Any) -> None:
        try:
            status = px4.status_from(message)
        except ValueError as error:
            self._complaint = str(error)
            return
        self._meters['status'].tick()
        changed, self._status = status != self._status, status
        if changed:  # the pilot took over, or handed over: at once
            self._step()

    def _on_vehicle_odometry(self, message: Any) -> None:
        try:
            pose = px4.pose_from(message)
        except ValueError as error:
            self._complaint = f'vehicle_odometry: {error}'
            return
        self._meters['odometry'].tick()
        self._odometry.take(message.timestamp_sample or message.timestamp, pose, message.reset_counter)

    def _on_vehicle_attitude(self, message: Any) -> None:
        if min(self._meters['odometry'].age, time.monotonic() - self._activated) > 0.5:  # a firmware that sends none
            try:
                pose = pose_from_px4(self._place.current if self._place.current is not None else (0.0,) * 3, message.q,
                                     (0.0,) * 3, (0.0,) * 3)
            except ValueError as error:
                self._complaint = f'vehicle_attitude: {error}'
                return
            # counted apart, so that a change of the source counts as a reset
            self._odometry.take(message.timestamp_sample or message.timestamp, pose, -1 - message.quat_reset_counter)
        if 0.9 < sum(part * part for part in message.q) < 1.1:
            self._meters['attitude'].tick()
            self._attitude = message.q

    def _on_vehicle_local_position(self, m: Any) -> None:
        valid = m.xy_valid and m.z_valid
        self._place.update([m.x, m.y, m.z], (m.xy_reset_counter, m.z_reset_counter), [*m.delta_xy, m.delta_z], valid)
        if valid:
            self._meters['position'].tick()

    def _on_vehicle_command_ack(self, message: Any) -> None:
        if self._status and message.target_system == self._status.system_id and (
                message.target_component == self._settings.component):
            self._gimbal.acknowledge(time.monotonic(), message.command, message.result)

    def _on_gimbal_device_attitude_status(self, message: Any) -> None:
        self._measured = px4.gimbal_from(message)

    def _on_register_ext_component_reply(self, m: Any) -> None:
        if self._mode is None or self._mode.registration:
            return
        registration = self._mode.on_reply(time.monotonic(), m.request_id, px4.text(m.name), m.px4_ros2_api_version,
                                           m.success, m.arming_check_id, m.mode_id)
        if registration:
            self._link.publish('config_control_setpoints', px4.control_message(
                self._link.messages, self._timestamp(), registration))
            self.get_logger().info(f'PX4 offers "{registration.name}" as mode {registration.mode_id}')

    def _on_arming_check_request(self, message: Any) -> None:
        if self._mode is None:
            return
        can_run = self._guard_inputs().healthy(self._guard.settings)
        answer = self._mode.on_question(time.monotonic(), message.request_id, can_run,
                                        getattr(message, 'valid_registrations_mask', None))
        if answer:
            self._link.publish('arming_check_reply', px4.answer_message(self._link.messages, self._timestamp(), answer))

    # to PX4

    def _on_timer(self) -> None:
        if time.monotonic() - self._last_step > 0.9 / self._settings.rate:
            self._step()
        if self._mode:
            request = self._mode.step(time.monotonic())
            if request:
                self._link.publish('register_ext_component_request', px4.register_message(
                    self._link.messages, self._timestamp(), request))

    def _step(self) -> None:
        now, inputs = time.monotonic(), self._guard_inputs()
        self._last_step = now
        if self._settings.gimbal.enabled:
            self._send_commands(self._gimbal.step(now, self._gimbal_inputs(inputs)))
        self._decision = self._guard.step(now, inputs)
        if self._decision.heartbeat and self._settings.turn_body:
            self._link.publish('offboard_control_mode', px4.offboard_message(self._link.messages, self._timestamp()))
        if self._decision.setpoint:
            self._send_setpoint(self._decision.yaw_rate)
        else:
            self._place.release()
        self._report()

    def _send_setpoint(self, yaw_rate: float) -> None:
        self._link.publish('trajectory_setpoint', px4.setpoint_message(
            self._link.messages, self._timestamp(), self._place.hold(), yaw_rate))

    def _send_commands(self, commands: list) -> None:
        system = self._status.system_id if self._status else 1
        for command in commands:
            self._link.publish('vehicle_command', px4.command_message(
                self._link.messages, self._timestamp(), command, system, self._settings.component))

    def _guard_inputs(self) -> Inputs:
        meters, command = self._meters, self._command
        place = self._place.held is not None or (self._place.current is not None
                                                 and meters['position'].age <= self._settings.timeouts.position)
        return Inputs(
            self._status, meters['status'].age, min(meters['attitude'].age, meters['odometry'].age), meters['position'].age,
            meters['command'].age, meters['bearing'].age, command.yaw_rate,
            self._settings.turn_body and command.move_body and command.mode != PointingCommand.MODE_HOLD,
            self._mode.active_mode(time.monotonic()) if self._mode else None, place, self._gimbal.unacknowledged)

    def _gimbal_inputs(self, inputs: Inputs) -> GimbalInputs:
        command, timeouts = self._command, self._settings.timeouts
        fresh = (inputs.status_age <= timeouts.status and inputs.attitude_age <= timeouts.attitude
                 and inputs.command_age <= timeouts.command and inputs.bearing_age <= timeouts.bearing)
        pan, tilt = command.pan, command.tilt
        if self._settings.gimbal.lock_to_horizon and self._attitude is not None and math.isfinite(pan + tilt):
            pan, tilt = levelled(pan, tilt, attitude_ned_to_enu(self._attitude))
        return GimbalInputs(
            command.move_gimbal, pan, tilt, command.pan_rate, fresh,
            self._status.nav_state if self._status and inputs.status_age <= timeouts.status else None,
            self._status.system_id if self._status else 1, self._measured)

    # what it says

    def _report(self) -> None:
        status = self._status
        values = {'armed': bool(status and status.armed), 'nav_state': status.nav_state if status else -1,
                  'failsafe': bool(status and status.failsafe), 'gimbal': self._gimbal.claim.value,
                  'body': self._decision.reason, 'offboard offered': self._decision.heartbeat and self._settings.turn_body,
                  'external mode': self._mode.registration.mode_id if self._mode and self._mode.registration else -1}
        if tuple(values.values()) != self._reported:
            self._reported = tuple(values.values())
            self._state.publish(DiagnosticStatus(
                level=DiagnosticStatus.OK, name='px4', message=self._decision.reason,
                values=[KeyValue(key=key, value=str(value)) for key, value in values.items()]))

    def diagnose(self, status: DiagnosticStatusWrapper) -> None:
        """What is missing and why nothing moves."""
        for complaint in self._complaints():
            status.mergeSummary(DiagnosticStatus.WARN, complaint)
        for name, meter in self._meters.items():
            status.add(f'{name} rate (Hz)', f'{meter.rate:.1f}')
        status.add('gimbal', self._gimbal.claim.value)
        status.add('gimbal takeovers', str(self._gimbal.takeovers))
        status.add('last acknowledgement', self._gimbal.last_result)
        status.add('body', self._decision.reason)
        status.add('heading and position resets', str(self._odometry.resets))

    def _complaints(self) -> list[str]:
        found = [*self._link.problems.values(), self._complaint, self._mode.complaint if self._mode else '']
        self._complaint = ''
        if self._link.topic('vehicle_status') is None and 'vehicle_status' not in self._link.problems:
            found.append('PX4 is not to be seen: is MicroXRCEAgent running, and UXRCE_DDS_CFG set?')
        elif self._meters['status'].age > self._settings.timeouts.status:
            found.append('no fresh vehicle_status')
        if self._settings.gimbal.enabled and self._gimbal.claim is Claim.ASKED and not self._gimbal.last_result:
            found.append('the claim of the gimbal is not acknowledged: is MNT_MODE_IN set to 4 or 0?'
                         if self._link.topic('vehicle_command_ack') else
                         'no vehicle_command_ack: add it to dds_topics.yaml (PX4 1.14), or set gimbal.need_ack to false')
        if self._gimbal.unacknowledged:
            found.append('commands are no longer acknowledged')
        return [complaint for complaint in found if complaint]


def main() -> None:
    """Run the node."""
    run(Px4Node)
