"""Conversion between px4_msgs or nav_msgs and the types of this package. Fields that a firmware lacks are omitted.

Functions that make a message have two common parameters: `messages` is the module px4_msgs.msg, `timestamp` (us) is the time
of sending, or 0 for PX4 to set it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from av_px4.commands import COMPONENT, Command
from av_px4.external_mode import MODE_NAME, Configure, Registration
from av_px4.handover import VehicleStatus

AUTOPILOT = 1                 # MAVLink component id
ARMED, ARMING_STATES = 2, 5   # arming_state, and the last that exists: PX4 1.14 has 0 and 3 to 5 for the ground, too
MODE_NEEDS = ('mode_req_angular_velocity', 'mode_req_attitude', 'mode_req_local_alt', 'mode_req_local_position',
              'mode_req_prevent_arming')
CONTROLLED = ('position', 'velocity', 'altitude', 'climb_rate', 'acceleration', 'attitude', 'rates', 'allocation')
TYPE_TRAJECTORY = 4           # of SetpointConfig
SETPOINT_TIMEOUT_MS = 500     # without setpoints, after which PX4 1.18 takes over; as COM_OF_LOSS_T in docs/guides/px4.md


def status_from(message: Any) -> VehicleStatus:
    """The status in a VehicleStatus. Raises ValueError for impossible values, the sign of another message version."""
    if message.arming_state > ARMING_STATES or message.nav_state > 31:
        raise ValueError(f'vehicle_status has arming_state {message.arming_state} and nav_state {message.nav_state}, which '
                         'do not exist: px4_msgs is not of the firmware\'s version')
    return VehicleStatus(message.nav_state, message.arming_state == ARMED, message.failsafe, message.system_id or 1,
                         message.nav_state_user_intention, message.nav_state_timestamp)


def command_message(messages: Any, timestamp: int, command: Command, system: int) -> Any:
    """A VehicleCommand to the autopilot.

    Parameters:
        messages, timestamp: see above
        command: number and parameters of the command
        system: MAVLink system id of the vehicle
    """
    numbers = {f'param{number}': float(value) for number, value in enumerate(command.params, 1)}
    return messages.VehicleCommand(timestamp=timestamp, command=command.command, target_system=system,
                                   target_component=AUTOPILOT, source_system=system, source_component=COMPONENT,
                                   from_external=True, **numbers)


def offboard_message(messages: Any, timestamp: int) -> Any:
    """The heartbeat that PX4 expects before and while OFFBOARD is selected."""
    return messages.OffboardControlMode(timestamp=timestamp, position=True)


def setpoint_message(messages: Any, timestamp: int, place_ned: NDArray, yaw_rate: float) -> Any:
    """A TrajectorySetpoint that holds a position.

    Parameters:
        messages, timestamp: see above
        place_ned (m, (3,)): position to hold, in the estimator's frame
        yaw_rate (rad/s): counter-clockwise; 0 holds the heading
    """
    nothing = [math.nan] * 3
    return messages.TrajectorySetpoint(
        timestamp=timestamp, position=[float(value) for value in place_ned], velocity=nothing, acceleration=nothing,
        jerk=nothing, yaw=math.nan, yawspeed=-yaw_rate if yaw_rate else math.nan)


def register_message(messages: Any, timestamp: int, request_id: int) -> Any:
    """The RegisterExtComponentRequest of a mode and its arming check."""
    version = getattr(messages.RegisterExtComponentRequest, 'LATEST_PX4_ROS2_API_VERSION', 1)
    message = messages.RegisterExtComponentRequest(
        timestamp=timestamp, request_id=request_id, px4_ros2_api_version=version, register_arming_check=True,
        register_mode=True)
    message.name = characters(MODE_NAME, message.name)
    return message


def unregister_message(messages: Any, timestamp: int, registration: Registration) -> Any:
    """The message that ends a registration."""
    message = messages.UnregisterExtComponent(
        timestamp=timestamp, arming_check_id=registration.arming_check_id, mode_id=registration.mode_id,
        mode_executor_id=-1)
    message.name = characters(MODE_NAME, message.name)
    return message


def configure_message(messages: Any, timestamp: int, configure: Configure) -> tuple[str, Any]:
    """Topic and message that tell PX4 what the external mode sends: positions and yaw, for which all controllers are needed."""
    mode = configure.registration
    if mode.version >= 2:
        return 'setpoint_config', messages.SetpointConfig(
            timestamp=timestamp, type=TYPE_TRAJECTORY, source_id=mode.mode_id, should_apply=True,
            timeout_ms=SETPOINT_TIMEOUT_MS)
    message = messages.VehicleControlMode(timestamp=timestamp)
    _set(message, source_id=mode.mode_id, **{f'flag_control_{name}_enabled': True for name in CONTROLLED})
    return 'config_control_setpoints', message


def answer_message(messages: Any, timestamp: int, request_id: int, registration: Registration, can_run: bool) -> Any:
    """The ArmingCheckReply: what the mode requires, that it cannot be armed in, and whether it can run.

    Parameters:
        messages, timestamp: see above
        request_id: number of PX4's request
        registration: of the mode
        can_run: whether it can run now
    """
    message = messages.ArmingCheckReply(
        timestamp=timestamp, request_id=request_id, registration_id=registration.arming_check_id, can_arm_and_run=can_run)
    _set(message, **dict.fromkeys(MODE_NEEDS, True))
    return message


def text(characters: Any) -> str:
    """The text of a fixed array of characters, up to its first zero."""
    return bytes(bytearray(int(character) for character in characters)).split(b'\0')[0].decode(errors='replace')


def characters(value: str, template: Any) -> NDArray:
    """The fixed array of characters of a text, as long as `template`. Raises ValueError for a text that is too long."""
    array = np.zeros(len(template), dtype=np.uint8)
    array[:len(value.encode())] = np.frombuffer(value.encode(), np.uint8)
    return array


def _set(message: Any, **fields: Any) -> None:
    for name, value in fields.items():
        if hasattr(message, name):
            setattr(message, name, value)
