"""The control logic of px4_node: messages of the rig and of PX4 with their arrival in, messages to publish out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from std_msgs.msg import Float32MultiArray, Header
from transforms3d.quaternions import mat2quat

from av_common.frames import BASE_FRAME, ODOM_FRAME, attitude_ned_to_enu
from av_common.freshness import FreshInput, Instant
from av_common.gimbal_geometry import BASE_STABILIZED, angles_of_command, pan_and_tilt
from av_common.gimbal_history import FEEDBACK_TIMEOUT_S
from av_common.pose_messages import odometry_message
from av_common.rate_meter import RateMeter
from av_common.rig import GimbalMount
from av_common.rig_messages import gimbal_message
from av_common.stamps import to_seconds, to_stamp
from av_common.stopping import OLDEST_MEASUREMENT_S, STOP_WITHIN
from av_interfaces.msg import Bearing, PointingCommand
from av_px4 import messages as px4
from av_px4.commands import COMPONENT, Command
from av_px4.external_mode import MODE_NAME, Configure, ExternalMode, Registration
from av_px4.gimbal import DEFAULT_MOUNT, GIMBAL_SIGMA, AfterTakeover, Gimbal, GimbalInputs, reported_rotation
from av_px4.guard import (
    ATTITUDE_TIMEOUT,
    COMMAND_TIMEOUT,
    MARGIN,
    POSITION_TIMEOUT,
    STATUS_TIMEOUT,
    BodyGuard,
    Decision,
    Inputs,
)
from av_px4.handover import VehicleStatus
from av_px4.odometry import (
    RADIANS_PER_RPM,
    ContinuousPose,
    HeldPosition,
    commanded_speeds,
    measured_speeds,
    pose_from_px4,
    px4_clock,
)

STREAMS = ('status', 'odometry', 'position', 'command', 'bearing', 'motors', 'gimbal')
MODE_MESSAGES = ('ArmingCheckReply', 'RegisterExtComponentRequest', 'UnregisterExtComponent', 'VehicleControlMode')
NO_MODE = 'the installed px4_msgs has no external modes (PX4 1.15 and later have): set offboard to have OFFBOARD turn the body'
RATE_HZ = 50.0        # of control steps without pointing commands; each command causes a step at once
GAP_S = 0.5           # without esc_status, after which actuator_motors takes its place
HEARTBEAT = 'offboard_control_mode'
AIMS = (PointingCommand.MODE_TRACK, PointingCommand.MODE_LOOK)    # modes in which the gimbal moves
# Messages whose age PX4 judges: one that waited in a stall must not count as new. It stamps all others on arrival, which does
# not depend on the synchronisation of clocks; answers to arming checks carry the number of the question.
STAMPED = frozenset({HEARTBEAT, 'trajectory_setpoint', 'vehicle_command'})
REGISTRATION = frozenset({'register_ext_component_request', 'unregister_ext_component', 'register_ext_component_reply'})
ODOMETRY_TOPIC, STATE_TOPIC, GIMBAL_TOPIC, MOTORS_TOPIC = 'odometry', 'px4/state', 'gimbal/state', 'motor_speeds'


class Outgoing(NamedTuple):
    """A message to publish.

    Parameters:
        topic: name of an input of PX4 without prefix and version, or one of this package's own topics
        message: message of the topic's type
    """

    topic: str
    message: Any


class Px4Stage:
    """Guard of the body motion, gimbal client, external mode and odometry, driven by messages.

    Methods named `on_*` take a message and its arrival (see Instant) and return the messages to publish. They raise
    ValueError for an unusable message. Commands and bearings of two publishers are not used (see Publishers).

    Attributes:
        max_rate (rad/s): largest yaw rate of the body.
        pose: the odometry's frame, with the estimator's corrections of heading and position.
        clock: PX4's clock; poses that it cannot date, for a second after a start or a jump, are not published.

    Parameters:
        parameters: px4_node's parameters (generated struct, or of `av_common.parameters.node_parameters`)
        messages: the module px4_msgs.msg of the firmware's version
        gimbal: the rig's gimbal; None where its description has none
    """

    def __init__(self, parameters: Any, messages: Any, gimbal: GimbalMount | None = None) -> None:
        self._parameters = p = parameters
        self.max_rate, self._full_speed = math.radians(p.body.rate_deg), RADIANS_PER_RPM * p.motors.full_rpm
        self.gimbal = Gimbal(gimbal or DEFAULT_MOUNT, p.gimbal.need_ack, AfterTakeover(p.gimbal.after_takeover))
        self.mode_missing = '' if all(hasattr(messages, name) for name in MODE_MESSAGES) else NO_MODE
        wanted = p.turn_body and p.external_mode and not self.mode_missing
        versions = (2,) if hasattr(messages, 'SetpointConfig') else (1,)
        self.mode = ExternalMode(versions) if wanted else None
        self.pose, self.clock = ContinuousPose(), px4_clock()
        self._measured_gimbal: tuple[float, float] | None = None    # rad, pan and tilt about the mount's axes
        self._gimbal_clock = px4_clock()
        self.meters = {name: RateMeter(now=self._steady) for name in STREAMS}
        self._guard = BodyGuard(self.max_rate, p.turn_body and p.offboard)
        self._messages, self._place = messages, HeldPosition()
        self._now = Instant(0.0, 0.0)
        self._commanded = FreshInput()
        self.contested: Mapping[str, list[str]] = {}  # publishers of the commands or bearings where there are several
        self._measured_target = FreshInput(OLDEST_MEASUREMENT_S - STOP_WITHIN + MARGIN)
        self._last_step = -math.inf
        self._status: VehicleStatus | None = None
        self._attitude: Any = None
        self._command = PointingCommand()
        self._reported: tuple[object, ...] = ()
        self.unused: set[str] = set()    # topics that PX4 does not have, or with other fields
        self.others = ''                 # who else steers the vehicle

    @property
    def decision(self) -> Decision:
        """The newest decision of the guard."""
        return self._guard.decision

    @property
    def system_id(self) -> int:
        """MAVLink id of the vehicle, 1 before its first status."""
        return self._status.system_id if self._status else 1

    def start(self, now: Instant, former: Registration | None = None) -> None:
        """Begin; must be called before the first message.

        Parameters:
            now: time of the start
            former: the external mode of an earlier process, which PX4 may still have
        """
        self._now = now
        if self.mode:
            self.mode.start(now.steady, former)

    def advance(self, now: Instant) -> None:
        """Set the instant to which the ages and rates of `meters` refer."""
        self._now = now

    def stop(self, now: Instant) -> list[Outgoing]:
        """The messages that stop the motion, release the gimbal, and unregister the external mode but in its failsafe."""
        self._now = now
        inputs = self._guard_inputs()
        waits = self._guard.waits(now.steady, inputs)    # as PX4 may have left the mode meanwhile
        out = [self._setpoint(0.0)] if self.decision.setpoint and inputs.place_known and not waits else []
        out += self._commands(self.gimbal.release())
        registration = self.mode.registration if self.mode else None
        if self.mode and registration and not (self._status and self._status.overrides(registration.mode_id)):
            out.append(self._out('unregister_ext_component', px4.unregister_message, registration))
            self.mode.forget('stopped')
        self._guard.stop()
        return out + self._report()

    def on_time(self, now: Instant) -> list[Outgoing]:
        """Make a step unless a message has just caused one, and register the mode. To be called at RATE_HZ."""
        self._now = now
        out = self._step() if now.steady - self._last_step > 0.9 / RATE_HZ else []
        return out + self._register()

    # from the rig

    def on_command(self, message: PointingCommand, arrival: Instant) -> list[Outgoing]:
        """Execute a pointing command at once; a command whose stamp is too old is ignored."""
        self._now = arrival
        stamp = message.header.stamp
        if 'pointing/command' in self.contested or not self._in_time(stamp, COMMAND_TIMEOUT):
            return []
        if message.header.frame_id not in ('', BASE_FRAME, BASE_STABILIZED):
            raise ValueError(f'a command in {message.header.frame_id!r}, expected {BASE_FRAME!r} or '
                             f'{BASE_STABILIZED!r}')
        self.meters['command'].tick()
        if self._commanded.take(to_seconds(stamp), arrival) or not (message.move_body or message.move_gimbal):
            self._command = message    # one that came before undoes none that came since, such as the end of pointing
        return self._step()

    def on_bearing(self, message: Bearing, arrival: Instant) -> list[Outgoing]:
        """Note the newest measurement of a bearing: the body moves by new ones only, whatever is published between them."""
        self._now = arrival
        measured = to_seconds(message.measured) if message.state != Bearing.STATE_NONE else math.nan
        if 'target/bearing' in self.contested:
            self._measured_target.skip(measured, arrival)
            return []
        if message.state != Bearing.STATE_NONE and self._in_time(message.header.stamp, OLDEST_MEASUREMENT_S):
            self.meters['bearing'].tick()
            if measured > 0.0:  # 0 is a bearing without a measurement
                self._measured_target.take(measured, arrival)
        return []

    # from PX4

    def on_vehicle_status(self, message: Any, arrival: Instant) -> list[Outgoing]:
        """Store the status; a change of mode, arming or failsafe takes effect at once."""
        self._now = arrival
        status = px4.status_from(message)
        self.meters['status'].tick()
        changed, self._status = status != self._status, status
        return self._step() if changed else []

    def on_vehicle_odometry(self, message: Any, arrival: Instant) -> list[Outgoing]:
        """Convert PX4's pose to the rig's odometry."""
        self._now = arrival
        pose = pose_from_px4(message.position, message.q, message.velocity, message.angular_velocity, message.pose_frame,
                             message.velocity_frame)
        self.meters['odometry'].tick()
        self._attitude = message.q
        time = 1e-6 * (message.timestamp_sample or message.timestamp)
        stamp = self.clock.date(time, arrival.ros)
        if stamp is None:
            return []
        pose, header = self.pose.add(time, pose, message.reset_counter), Header(stamp=to_stamp(stamp), frame_id=ODOM_FRAME)
        return [Outgoing(ODOMETRY_TOPIC, odometry_message(header, BASE_FRAME, pose.position, pose.attitude_wxyz,
                                                          pose.velocity_flu, pose.rate_flu))]

    def on_vehicle_local_position(self, message: Any, arrival: Instant) -> list[Outgoing]:
        """Store the position, which is held while the body turns."""
        self._now = arrival
        valid = message.xy_valid and message.z_valid
        self._place.update(np.array([message.x, message.y, message.z]), (message.xy_reset_counter, message.z_reset_counter),
                           np.array([*message.delta_xy, message.delta_z]), valid)
        if valid:
            self.meters['position'].tick()
        return []

    def on_vehicle_command_ack(self, message: Any, arrival: Instant) -> list[Outgoing]:
        """Pass an acknowledgement to the gimbal client; acknowledgements to other components are ignored."""
        self._now = arrival
        if self._status and (message.target_system, message.target_component) == (
                self._status.system_id, COMPONENT):
            self.gimbal.acknowledge(arrival.steady, message.command, message.result)
        return []

    def on_gimbal_device_attitude_status(self, message: Any, arrival: Instant) -> list[Outgoing]:
        """Publish the gimbal's orientation, from which its motion also starts after a claim; nothing without an attitude.

        Only a MAVLink gimbal measures. For one on PWM or CAN outputs PX4 reports its own setpoint, which tells no more than
        where a claim begins.
        """
        self._now = arrival
        if not self.meters['odometry'].age <= ATTITUDE_TIMEOUT:
            return []
        attitude, mount = attitude_ned_to_enu(self._attitude).tolist(), self.gimbal.mount
        turned = reported_rotation(message, attitude)
        self._measured_gimbal = pan_and_tilt(mount, turned, attitude)
        self.meters['gimbal'].tick()
        time = self._gimbal_clock.date(1e-6 * message.timestamp, arrival.ros) if message.timestamp else None
        if time is None or not message.received_from_mavlink:
            return []
        return [Outgoing(GIMBAL_TOPIC, gimbal_message(mount.frame, time, mat2quat(turned), GIMBAL_SIGMA**2, measured=True))]

    def on_esc_status(self, message: Any, arrival: Instant) -> list[Outgoing]:
        """Publish the speeds that the controllers of the motors report."""
        self._now = arrival
        speeds = measured_speeds(message)
        if not any(map(math.isfinite, speeds)):    # controllers without telemetry: what is commanded says more
            return []
        self.meters['motors'].tick()
        return [Outgoing(MOTORS_TOPIC, Float32MultiArray(data=speeds))]

    def on_actuator_motors(self, message: Any, arrival: Instant) -> list[Outgoing]:
        """Publish the speeds that are commanded, where none are reported and the speed at full command is known."""
        self._now = arrival
        if not self._full_speed or self.meters['motors'].age <= GAP_S:
            return []
        return [Outgoing(MOTORS_TOPIC, Float32MultiArray(data=commanded_speeds(message, self._full_speed)))]

    def on_register_ext_component_reply(self, message: Any, arrival: Instant) -> list[Outgoing]:
        """Process PX4's reply to the registration of the external mode."""
        self._now = arrival
        if self.mode is not None:
            self.mode.on_reply(
                arrival.steady, message.request_id, px4.text(message.name), message.px4_ros2_api_version, message.success,
                message.arming_check_id, message.mode_id, bool(self._status and self._status.armed))
        return self._register()

    def on_setpoint_config_reply(self, message: Any, arrival: Instant) -> list[Outgoing]:
        """Process PX4's reply to the configuration of the external mode."""
        self._now = arrival
        if self.mode is not None:
            self.mode.on_configured(message.source_id, message.result)
        return []

    def on_arming_check_request(self, message: Any, arrival: Instant) -> list[Outgoing]:
        """Reply to PX4's request whether the external mode can run."""
        self._now = arrival
        inputs = self._guard_inputs()
        if self.mode is None or self._guard.waits(arrival.steady, inputs):
            return []    # an answer might bring the vehicle back to a mode that PX4 has left
        can_run = self.mode.on_question(arrival.steady, not self._guard.unwilling(inputs),
                                        getattr(message, 'valid_registrations_mask', None))
        return [] if can_run is None else [self._out(
            'arming_check_reply', px4.answer_message, message.request_id, self.mode.registration, can_run)]

    # decisions

    @property
    def offboard_withheld(self) -> str:
        """Why the pilot cannot select OFFBOARD; empty if PX4 is sent the heartbeat that it asks for."""
        if not self._parameters.turn_body:
            return 'turn_body is false'
        return self.decision.withheld or (
            f'PX4 does not read {HEARTBEAT}: see dds_topics.yaml' if HEARTBEAT in self.unused else '')

    @property
    def mode_withheld(self) -> str:
        """Why the pilot cannot select the rig's own mode; empty if it can run."""
        if not (self._parameters.turn_body and self._parameters.external_mode):
            return 'turn_body is false' if self._parameters.external_mode else 'external_mode is false'
        if self.mode is None:
            return self.mode_missing
        missing = sorted(self.unused & REGISTRATION)
        return self.mode.problem or (self._guard.unwilling(self._guard_inputs()) if self.mode.registration else
                                     f'PX4 has no {missing[0]}' if missing else 'not registered yet')

    def _register(self) -> list[Outgoing]:
        """Steps of the registration of the external mode."""
        if self.mode is None:
            return []
        heard = self.meters['status'].age <= STATUS_TIMEOUT and not self.unused & REGISTRATION
        step = self.mode.step(self._now.steady, heard, self._status)
        if isinstance(step, Registration):
            return [self._out('unregister_ext_component', px4.unregister_message, step)]
        if isinstance(step, Configure):
            return [Outgoing(*px4.configure_message(self._messages, 0, step))]
        return [self._out('register_ext_component_request', px4.register_message, step)] if step is not None else []

    def _step(self) -> list[Outgoing]:
        inputs, out = self._guard_inputs(), []
        self._last_step = self._now.steady
        if self._parameters.gimbal.enabled:
            out += self._commands(self.gimbal.step(self._now.steady, self._gimbal_inputs(inputs)))
        decision = self._guard.step(self._now.steady, inputs)
        if decision.heartbeat:
            out.append(self._out(HEARTBEAT, px4.offboard_message))
        if decision.setpoint:
            out.append(self._setpoint(decision.yaw_rate))
        else:
            self._place.release()
        return out + self._report()

    def _guard_inputs(self) -> Inputs:
        meters, command = self.meters, self._command
        place = self._place.held is not None or (self._place.current is not None
                                                 and meters['position'].age <= POSITION_TIMEOUT)
        return Inputs(
            self._status, meters['status'].age, meters['odometry'].age, meters['position'].age,
            self._commanded.age(self._now), self._measured_target.age(self._now),
            0.0 if command.mode == PointingCommand.MODE_HOLD else command.yaw_rate,
            self._parameters.turn_body and command.move_body,
            self.mode.active_mode(self._now.steady) if self.mode else None, place, self.others, self.gimbal.unacknowledged)

    def _gimbal_inputs(self, inputs: Inputs) -> GimbalInputs:
        command = self._command
        fresh = (command.mode in AIMS and inputs.status_age <= STATUS_TIMEOUT
                 and inputs.attitude_age <= ATTITUDE_TIMEOUT and inputs.command_age <= COMMAND_TIMEOUT)
        pan, tilt = command.pan, command.tilt
        if self._attitude is not None and math.isfinite(pan + tilt):
            pan, tilt = angles_of_command(self.gimbal.mount, pan, tilt, command.header.frame_id == BASE_STABILIZED,
                                          attitude_ned_to_enu(self._attitude).tolist())
        return GimbalInputs(
            command.move_gimbal, pan, tilt, command.pan_rate, fresh,
            self._status.nav_state if self._status and inputs.status_age <= STATUS_TIMEOUT else None,
            self.system_id, self._measured_gimbal if self.meters['gimbal'].age <= FEEDBACK_TIMEOUT_S else None)

    def _steady(self) -> float:
        return self._now.steady

    def _in_time(self, stamp: Time, limit: float) -> bool:
        """Whether the stamp is at most `limit` s old: a message that waited in a queue is not fresh on arrival."""
        return bool(abs(self._now.ros - to_seconds(stamp)) <= limit)

    # messages

    def _out(self, topic: str, make: Any, *content: Any) -> Outgoing:
        return Outgoing(topic, make(self._messages, round(1e6 * self._now.ros) if topic in STAMPED else 0, *content))

    def _setpoint(self, yaw_rate: float) -> Outgoing:
        return self._out('trajectory_setpoint', px4.setpoint_message, self._place.hold(), yaw_rate)

    def _commands(self, commands: list[Command]) -> list[Outgoing]:
        return [self._out('vehicle_command', px4.command_message, command, self.system_id)
                for command in commands]

    def _report(self) -> list[Outgoing]:
        """The message of the state if it has changed."""
        status, mode, withheld, unwilling = self._status, self.mode, self.offboard_withheld, self.mode_withheld
        values = {'armed': bool(status and status.armed), 'nav_state': status.nav_state if status else -1,
                  'failsafe': bool(status and status.failsafe), 'gimbal': self.gimbal.state,
                  'body': self.decision.reason, 'others': self.others,
                  'offboard offered': not withheld, 'offboard withheld': withheld,
                  'external mode': mode.registration.mode_id if mode and mode.registration else -1,
                  'external mode withheld': unwilling}
        if tuple(values.values()) == self._reported:
            return []
        self._reported = tuple(values.values())
        said = [self.decision.reason, f'OFFBOARD is not offered: {withheld}' if withheld and self._parameters.offboard else '',
                f'"{MODE_NAME}" cannot run: {unwilling}' if unwilling and self._parameters.external_mode else '']
        return [Outgoing(STATE_TOPIC, DiagnosticStatus(
            level=DiagnosticStatus.OK, name='px4', message='; '.join(part for part in said if part),
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()]))]
