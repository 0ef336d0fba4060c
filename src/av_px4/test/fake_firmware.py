"""The fake autopilot as PX4 of one firmware: messages in, messages out."""

from __future__ import annotations

import math

from fake_autopilot import FakeAutopilot
from px4_layouts import definitions

from av_px4.layouts import layout_hash
from av_px4.messages import characters, text

OUTPUTS = {'vehicle_status': 'VehicleStatus', 'vehicle_odometry': 'VehicleOdometry',
           'vehicle_local_position': 'VehicleLocalPosition'}
INPUTS = {'vehicle_command': 'VehicleCommand', 'offboard_control_mode': 'OffboardControlMode',
          'trajectory_setpoint': 'TrajectorySetpoint'}
MODE_OUTPUTS = {'register_ext_component_reply': 'RegisterExtComponentReply', 'arming_check_request': 'ArmingCheckRequest',
                'message_format_response': 'MessageFormatResponse', 'vehicle_command_ack': 'VehicleCommandAck'}
MODE_INPUTS = {'register_ext_component_request': 'RegisterExtComponentRequest', 'arming_check_reply': 'ArmingCheckReply',
               'unregister_ext_component': 'UnregisterExtComponent', 'message_format_request': 'MessageFormatRequest',
               'goto_setpoint': 'GotoSetpoint'}
PERIOD = 0.01      # s, of `tick`


def quaternion(yaw, pitch=0.0):
    """(w, x, y, z) of yaw, then pitch."""
    cy, sy, cp, sp = math.cos(yaw / 2), math.sin(yaw / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    return [cy * cp, -sy * sp, cy * sp, sy * cp]


class FakeFirmware:
    """`tick` advances the vehicle and gives what PX4 publishes; `take` gives its replies. Both as (topic, message).

    firmware: '1.14' to '1.18'.  messages: its px4_msgs.msg, or plain_messages of it.  told: firmware whose layouts it has when
    asked; another one for a px4_msgs that is not of the firmware.
    """

    def __init__(self, firmware, messages, told=None, **model):
        number = float(firmware)
        self.firmware, self.messages, self.ticks = firmware, messages, 0
        self.model = FakeAutopilot(obeys_any_mode=firmware == '1.16', interface=2 if number >= 1.18 else 1, **model)
        self._layouts = definitions(told or firmware)
        self._told, self.flagged = None, True    # whether vehicle_status flags a failsafe
        self.outputs = OUTPUTS | (MODE_OUTPUTS if number >= 1.15 else {})
        self.inputs = INPUTS | (MODE_INPUTS if number >= 1.15 else {})
        if number >= 1.17:
            self.outputs['gimbal_device_attitude_status'] = 'GimbalDeviceAttitudeStatus'
        if number >= 1.18:
            self.outputs['setpoint_config_reply'], self.inputs['setpoint_config'] = 'SetpointConfigReply', 'SetpointConfig'
        elif number >= 1.15:
            self.inputs['config_control_setpoints'] = 'VehicleControlMode'
        self.kinds = self.outputs | self.inputs

    def take(self, name, message, now=0):
        """The replies to a message; now: PX4's time in us."""
        replies = getattr(self, f'_on_{name}')(message)
        for _, reply in replies or ():
            reply.timestamp = now
        return replies or []

    def tick(self, now):
        """Advance by PERIOD; now: PX4's time in us."""
        model, messages, k = self.model, self.messages, self.ticks
        self.ticks += 1
        model.advance(PERIOD)
        heading, reset = model.estimated_heading, model.resets
        q = quaternion(heading)
        yield 'vehicle_odometry', messages.VehicleOdometry(
            timestamp=now, timestamp_sample=now, pose_frame=1, velocity_frame=1, position=list(model.position), q=q,
            velocity=list(model.velocity), angular_velocity=[0.0, 0.0, model.yaw_rate], reset_counter=reset)
        if k % 2 == 0:
            x, y, z = model.position
            yield 'vehicle_local_position', messages.VehicleLocalPosition(
                timestamp=now, xy_valid=True, z_valid=True, x=x, y=y, z=z, heading=heading, heading_reset_counter=reset,
                delta_heading=model.last_reset, heading_good_for_control=True)
        state = model.nav_state, model.intended, model.armed, model.failsafe
        if k % 50 == 0 or state != self._told:
            self._told = state
            yield 'vehicle_status', messages.VehicleStatus(
                timestamp=now, nav_state=model.nav_state, nav_state_user_intention=model.intended,
                nav_state_timestamp=round(1e6 * model.changed), arming_state=2 if model.armed else 1,
                failsafe=model.failsafe and self.flagged, system_id=model.system, component_id=1)
        if k % 30 == 0 and model.modes:
            yield 'arming_check_request', self._question(now)
        if k % 5 == 0 and 'gimbal_device_attitude_status' in self.outputs:
            yield 'gimbal_device_attitude_status', messages.GimbalDeviceAttitudeStatus(
                timestamp=now, device_flags=12 + 32, q=quaternion(model.gimbal[1], model.gimbal[0]), received_from_mavlink=True)

    def _question(self, now):
        self.model.question = (self.model.question + 1) % 256
        request = self.messages.ArmingCheckRequest(timestamp=now, request_id=self.model.question)
        if hasattr(request, 'valid_registrations_mask'):
            request.valid_registrations_mask = sum(1 << number for number, mode in self.model.modes.items() if not mode.silent)
        return request

    def _on_offboard_control_mode(self, m):
        self.model.heartbeat()

    def _on_trajectory_setpoint(self, m):
        self.model.setpoint(m.position, m.yaw, m.yawspeed)

    def _on_goto_setpoint(self, m):
        self.model.setpoint(m.position, math.nan, math.nan)

    def _on_vehicle_command(self, m):
        result = self.model.command(m.command, [getattr(m, f'param{k}') for k in range(1, 8)],
                                    (m.source_system, m.source_component), (m.target_system, m.target_component))
        return [] if result is None else [('vehicle_command_ack', self.messages.VehicleCommandAck(
            command=m.command, result=result, target_system=m.source_system, target_component=m.source_component))]

    def _on_register_ext_component_request(self, m):
        granted = self.model.register(text(m.name))
        number, nav_state = granted or (-1, -1)
        return [('register_ext_component_reply', self.messages.RegisterExtComponentReply(
            request_id=m.request_id, name=m.name, px4_ros2_api_version=self.model.interface, success=granted is not None,
            arming_check_id=number, mode_id=nav_state, mode_executor_id=-1))]

    def _on_unregister_ext_component(self, m):
        self.model.unregister(m.arming_check_id)

    def _on_arming_check_reply(self, m):
        self.model.answer(m.registration_id, m.can_arm_and_run, m.request_id)

    def _on_config_control_setpoints(self, m):
        self.model.configure(m.source_id)

    def _on_setpoint_config(self, m):
        known = m.should_apply and self.model.configure(m.source_id, 1e-3 * m.timeout_ms or math.inf)
        return [('setpoint_config_reply', self.messages.SetpointConfigReply(
            type=m.type, source_id=m.source_id, result=0 if m.type == 4 and known else 1))]

    def _on_message_format_request(self, m):
        topic = text(m.topic_name).rpartition('/')[2]
        response = self.messages.MessageFormatResponse(protocol_version=1, success=topic in self.kinds, message_hash=0)
        response.topic_name = characters(text(m.topic_name), response.topic_name)
        if response.success:
            response.message_hash = layout_hash(self.kinds[topic], lambda name: self._layouts[name].replace('; ', '\n'))
        return [('message_format_response', response)]
