"""Message definitions as PX4 1.14 to 1.18 have them, built into a package `px4_msgs` for the tests alone.

`overlay('1.16')` generates and builds that firmware's package, once, in the project's ignored folder `build`, and returns
the environment in which a process finds it. Nothing of this is installed with the suite.

python3 src/av_px4/test/px4_layouts.py 1.16 ros2 run av_px4 px4_node    # any command, with these messages
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

FIRMWARES = ('1.14', '1.15', '1.16', '1.17', '1.18')
CACHE = Path(__file__).resolve().parents[3] / 'build' / 'test_px4_msgs'

_STAMP = 'uint64 timestamp'
_SAMPLED = f'{_STAMP}; uint64 timestamp_sample'
_NAME = 'char[25] name'
_POSITION_A = (f'{_SAMPLED}; bool xy_valid; bool z_valid; bool v_xy_valid; bool v_z_valid; float32 x; float32 y; float32 z; '
               'float32[2] delta_xy; uint8 xy_reset_counter; float32 delta_z; uint8 z_reset_counter; float32 vx; float32 vy; '
               'float32 vz; float32 z_deriv; float32[2] delta_vxy; uint8 vxy_reset_counter; float32 delta_vz; '
               'uint8 vz_reset_counter; float32 ax; float32 ay; float32 az; float32 heading; ')
_POSITION_B = 'float32 delta_heading; uint8 heading_reset_counter; bool heading_good_for_control; '
_POSITION_C = 'bool xy_global; bool z_global; uint64 ref_timestamp; float64 ref_lat; float64 ref_lon; float32 ref_alt; '
_POSITION_D = 'float32 eph; float32 epv; float32 evh; float32 evv; bool dead_reckoning; float32 vxy_max; float32 vz_max; '
_VARIANCES = 'float32 heading_var; float32 unaided_heading; '
_STATUS_A = (f'{_STAMP}; uint64 armed_time; uint64 takeoff_time; uint8 arming_state; uint8 latest_arming_reason; '
             'uint8 latest_disarming_reason; uint64 nav_state_timestamp; uint8 nav_state_user_intention; uint8 nav_state; ')
_FAILURES = 'uint16 failure_detector_status; '
_STATUS_B = 'uint8 hil_state; uint8 vehicle_type; bool failsafe; bool failsafe_and_user_took_over; '
_STATUS_C = ('bool gcs_connection_lost; uint8 gcs_connection_lost_counter; bool high_latency_data_link_lost; bool is_vtol; '
             'bool is_vtol_tailsitter; bool in_transition_mode; bool in_transition_to_fw; uint8 system_type; uint8 system_id; '
             'uint8 component_id; bool safety_button_available; bool safety_off; bool power_input_valid; bool usb_connected; '
             'bool open_drone_id_system_present; bool open_drone_id_system_healthy; bool parachute_system_present; '
             'bool parachute_system_healthy; ')
_STATUS_D = 'bool rc_calibration_in_progress; bool calibration_enabled; bool pre_flight_checks_pass'
_AVOIDANCE = 'bool avoidance_system_required; bool avoidance_system_valid; '
_TRAFFIC = 'bool traffic_avoidance_system_present; '
_EXECUTOR = 'uint8 executor_in_charge; '
_DISPLAY = 'uint8 nav_state_display; bool accepts_offboard_setpoints; '
_MASKS = 'uint32 valid_nav_states_mask; uint32 can_set_nav_states_mask; '
_DEFER = 'uint8 failsafe_defer_state; '
_CHECK = (f'{_STAMP}; uint8 request_id; uint8 registration_id; uint8 health_component_index; bool health_component_is_present; '
          'bool health_component_warning; bool health_component_error; bool can_arm_and_run; uint8 num_events; '
          'Event[5] events; '
          'bool mode_req_angular_velocity; bool mode_req_attitude; bool mode_req_local_alt; bool mode_req_local_position; '
          'bool mode_req_local_position_relaxed; bool mode_req_global_position; ')
_CHECK_END = 'bool mode_req_mission; bool mode_req_home_position; bool mode_req_prevent_arming; bool mode_req_manual_control'
_GIMBAL = (f'{_STAMP}; uint8 target_system; uint8 target_component; uint16 device_flags; float32[4] q; '
           'float32 angular_velocity_x; float32 angular_velocity_y; float32 angular_velocity_z; uint32 failure_flags; ')
_ESC = (f'{_STAMP}; uint32 esc_errorcount; int32 esc_rpm; float32 esc_voltage; float32 esc_current; float32 esc_temperature; ')
_ESC_END = 'uint8 esc_state; uint8 actuator_function; uint16 failures; int8 esc_power'
_FORMAT = f'{_STAMP}; uint16 protocol_version; char[50] topic_name'


def definitions(firmware: str) -> dict[str, str]:
    """Fields of each message of a firmware, in the wire's order, separated by semicolons."""
    number = FIRMWARES.index(firmware)
    component = 'uint16' if number >= 1 else 'uint8'
    bottom = ('bool dist_bottom_valid; float32 dist_bottom; float32 dist_bottom_var; float32 delta_dist_bottom; '
              'uint8 dist_bottom_reset_counter; ' if number >= 2 else 'float32 dist_bottom; bool dist_bottom_valid; ')
    messages = {
        'GimbalDeviceAttitudeStatus': _GIMBAL + (
            'float32 delta_yaw; float32 delta_yaw_velocity; uint8 gimbal_device_id; ' if number >= 2 else '')
            + 'bool received_from_mavlink',
        'ActuatorMotors': f'{_SAMPLED}; uint16 reversible_flags; float32[12] control',
        'EscReport': _ESC + ('int16 motor_temperature; ' if number >= 4
                             else 'uint8 esc_address; uint8 esc_cmdcount; ') + _ESC_END,
        'EscStatus': f'{_STAMP}; uint16 counter; uint8 esc_count; uint8 esc_connectiontype; '
                     + ('uint16 esc_online_flags; uint16 esc_armed_flags; EscReport[12] esc' if number >= 4
                        else 'uint8 esc_online_flags; uint8 esc_armed_flags; EscReport[8] esc'),
        'OffboardControlMode': f'{_STAMP}; bool position; bool velocity; bool acceleration; bool attitude; bool body_rate; '
                               + ('bool thrust_and_torque; bool direct_actuator' if number >= 1 else 'bool actuator'),
        'TrajectorySetpoint': f'{_STAMP}; float32[3] position; float32[3] velocity; float32[3] acceleration; float32[3] jerk; '
                              'float32 yaw; float32 yawspeed',
        'VehicleAttitude': f'{_SAMPLED}; float32[4] q; float32[4] delta_q_reset; uint8 quat_reset_counter',
        'VehicleCommand': f'{_STAMP}; float32 param1; float32 param2; float32 param3; float32 param4; float64 param5; '
                          'float64 param6; float32 param7; uint32 command; uint8 target_system; uint8 target_component; '
                          f'uint8 source_system; {component} source_component; uint8 confirmation; bool from_external',
        'VehicleCommandAck': f'{_STAMP}; uint32 command; uint8 result; uint8 result_param1; int32 result_param2; '
                             f'uint8 target_system; {component} target_component; bool from_external'
                             + ('; uint32 MESSAGE_VERSION=1' if number >= 4 else ''),
        'VehicleLocalPosition': _POSITION_A + (_VARIANCES if number >= 1 else '') + _POSITION_B
                                + ('float32 tilt_var; ' if number >= 1 else '') + _POSITION_C + bottom
                                + 'uint8 dist_bottom_sensor_bitfield; ' + _POSITION_D
                                + ('float32 hagl_min; float32 hagl_max_z; float32 hagl_max_xy' if number >= 2
                                   else 'float32 hagl_min; float32 hagl_max')
                                + ('; uint32 MESSAGE_VERSION=1' if number >= 3 else ''),
        'VehicleOdometry': f'{_SAMPLED}; uint8 pose_frame; float32[3] position; float32[4] q; uint8 velocity_frame; '
                           'float32[3] velocity; float32[3] angular_velocity; float32[3] position_variance; '
                           'float32[3] orientation_variance; float32[3] velocity_variance; uint8 reset_counter; int8 quality',
        'VehicleStatus': _STATUS_A + (_EXECUTOR if number >= 1 else '') + (_DISPLAY if number >= 4 else '')
                         + (_MASKS if number >= 1 else '') + (_FAILURES if number < 4 else '') + _STATUS_B
                         + (_DEFER if number >= 1 else '') + _STATUS_C + (_AVOIDANCE if number < 2 else '')
                         + (_TRAFFIC if number >= 4 else '') + _STATUS_D
                         + ('' if number < 2 else f'; uint32 MESSAGE_VERSION={4 if number >= 4 else 1}'),
    }
    if number == 0:
        return messages
    version = '; uint32 MESSAGE_VERSION=1' if number >= 3 else ''
    unselectable = '; bool not_user_selectable' if number >= 4 else ''
    interface = 2 if number >= 4 else 1
    if number >= 4:
        messages |= {'SetpointConfig': f'{_STAMP}; uint16 type; uint8 source_id; bool should_apply; uint16 timeout_ms',
                     'SetpointConfigReply': f'{_STAMP}; uint16 type; uint8 source_id; uint8 result; '
                                            'bool mode_req_angular_velocity; bool mode_req_attitude; bool mode_req_local_alt; '
                                            'bool mode_req_local_position'}
    return messages | {
        'ArmingCheckReply': _CHECK + ('bool mode_req_global_position_relaxed; ' if number >= 3 else '') + _CHECK_END + version,
        'ArmingCheckRequest': f'{_STAMP}; uint8 request_id' + (
            '; uint32 valid_registrations_mask' if number >= 3 else '') + version,
        'Event': f'{_STAMP}; uint32 id; uint16 event_sequence; uint8[25] arguments; uint8 log_levels{version}',
        'GotoSetpoint': f'{_STAMP}; float32[3] position; bool flag_control_heading; float32 heading; '
                        'bool flag_set_max_horizontal_speed; float32 max_horizontal_speed; bool flag_set_max_vertical_speed; '
                        'float32 max_vertical_speed; bool flag_set_max_heading_rate; float32 max_heading_rate',
        'MessageFormatRequest': _FORMAT,
        'MessageFormatResponse': f'{_FORMAT}; bool success; uint32 message_hash',
        'RegisterExtComponentReply': f'{_STAMP}; uint64 request_id; {_NAME}; uint16 px4_ros2_api_version; bool success; '
                                     f'int8 arming_check_id; int8 mode_id; int8 mode_executor_id{unselectable}'
                                     + ('; uint32 MESSAGE_VERSION=1' if number >= 4 else ''),
        'RegisterExtComponentRequest': f'{_STAMP}; uint64 request_id; {_NAME}; uint16 px4_ros2_api_version; '
                                       'bool register_arming_check; bool register_mode; bool register_mode_executor; '
                                       'bool enable_replace_internal_mode; uint8 replace_internal_mode; '
                                       f'bool activate_mode_immediately{unselectable}'
                                       + ('; bool request_offboard_setpoints; uint32 MESSAGE_VERSION=2' if number >= 4 else '')
                                       + f'; uint16 LATEST_PX4_ROS2_API_VERSION={interface}',
        'UnregisterExtComponent': f'{_STAMP}; {_NAME}; int8 arming_check_id; int8 mode_id; int8 mode_executor_id',
        'VehicleControlMode': f'{_STAMP}; bool flag_armed; bool flag_multicopter_position_control_enabled; '
                              'bool flag_control_manual_enabled; bool flag_control_auto_enabled; '
                              'bool flag_control_offboard_enabled; bool flag_control_position_enabled; '
                              'bool flag_control_velocity_enabled; bool flag_control_altitude_enabled; '
                              'bool flag_control_climb_rate_enabled; '
                              + ('' if number >= 4 else 'bool flag_control_acceleration_enabled; ')
                              + 'bool flag_control_attitude_enabled; bool flag_control_rates_enabled; '
                              'bool flag_control_allocation_enabled'
                              + ('' if number >= 4 else '; bool flag_control_termination_enabled; uint8 source_id'),
    }


# Only the generators that Python nodes use with this middleware: all of them would take four times as long.
_MIDDLEWARE = 'introspection_c' if 'cyclone' in os.environ.get('RMW_IMPLEMENTATION', '') else 'fastrtps_c'
_CMAKE = '''cmake_minimum_required(VERSION 3.8)
project(px4_msgs C CXX)
foreach(package ament_cmake rosidl_cmake rosidl_generator_type_description rosidl_generator_c
        rosidl_typesupport_MIDDLEWARE rosidl_typesupport_c rosidl_generator_py)
  find_package(${package} REQUIRED)
endforeach()
file(GLOB messages RELATIVE ${CMAKE_CURRENT_SOURCE_DIR} msg/*.msg)
rosidl_generate_interfaces(${PROJECT_NAME} ${messages})
set_target_properties(px4_msgs__rosidl_generator_c PROPERTIES UNITY_BUILD OFF) # its files share names of statics
ament_package()
'''
_PACKAGE = '''<?xml version="1.0"?>
<package format="3">
  <name>px4_msgs</name><version>0.0.0</version><description>For tests.</description>
  <maintainer email="av_rig@users.noreply.github.com">The av_rig maintainers</maintainer><license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend><buildtool_depend>rosidl_default_generators</buildtool_depend>
  <exec_depend>rosidl_default_runtime</exec_depend><member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
'''


def overlay(firmware: str) -> dict[str, str]:
    """Environment variables of a process that finds this firmware's `px4_msgs`, built if need be."""
    files = {f'msg/{name}.msg': '\n'.join(map(str.strip, text.split(';'))) + '\n'
             for name, text in definitions(firmware).items()}
    files |= {'CMakeLists.txt': _CMAKE.replace('MIDDLEWARE', _MIDDLEWARE), 'package.xml': _PACKAGE}
    digest = hashlib.sha256(repr(sorted(files.items())).encode()).hexdigest()[:12]
    folder = CACHE / f'{firmware}-{digest}'
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / 'lock').open('w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / 'ready').exists():
            _build(folder, files)
            (folder / 'ready').touch()
    install = folder / 'install'
    packages = next(install.glob('**/px4_msgs/__init__.py')).parents[1]
    added = {'AMENT_PREFIX_PATH': install, 'LD_LIBRARY_PATH': install / 'lib', 'PYTHONPATH': packages}
    return {name: f'{path}{os.pathsep}{os.environ.get(name, "")}' for name, path in added.items()}


def plain_messages(firmware: str) -> SimpleNamespace:
    """The messages of a firmware as classes of Python alone, in place of `px4_msgs.msg` where nothing is sent."""
    return SimpleNamespace(**{name: _plain(name, text) for name, text in definitions(firmware).items()})


def _plain(name: str, text: str) -> type:
    spelled = {'bool': 'boolean', 'float32': 'float', 'float64': 'double', 'char': 'uint8'}
    constants = {part.split()[1].partition('=')[0]: int(part.partition('=')[2]) for part in text.split(';') if '=' in part}
    fields = {}
    for kind, field in (part.split() for part in text.split(';') if '=' not in part):
        scalar, bracket, count = kind.partition('[')
        fields[field] = spelled.get(scalar, scalar) + bracket + count

    def zero(kind: str) -> Any:
        if kind.endswith(']'):
            return [0] * int(kind[:-1].partition('[')[2])
        return {'float': 0.0, 'double': 0.0, 'boolean': False}.get(kind, 0)

    def start(self: Any, **values: Any) -> None:
        vars(self).update({field: zero(kind) for field, kind in fields.items()} | values)

    return type(name, (), {'__init__': start, 'get_fields_and_field_types': classmethod(lambda _: fields), **constants})


def _build(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        path = folder / 'source' / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    for step in (['cmake', '-S', 'source', '-B', 'build', '-DCMAKE_INSTALL_PREFIX=install', '-DCMAKE_BUILD_TYPE=',
                  '-DBUILD_TESTING=OFF', '-DCMAKE_UNITY_BUILD=ON', '-DCMAKE_UNITY_BUILD_BATCH_SIZE=100'],
                 ['cmake', '--build', 'build', '--parallel', '2'], ['cmake', '--install', 'build']):
        result = subprocess.run(step, cwd=folder, text=True, capture_output=True, check=False)
        if result.returncode:
            raise RuntimeError(f'{" ".join(step)} failed:\n{result.stdout[-3000:]}\n{result.stderr[-3000:]}')


def main() -> None:
    """Become a command that finds a firmware's messages."""
    if len(sys.argv) < 3 or sys.argv[1] not in FIRMWARES:
        sys.exit(f'usage: px4_layouts.py {{{",".join(FIRMWARES)}}} COMMAND [ARGUMENT ...]')
    os.environ.update(overlay(sys.argv[1]))
    os.execvp(sys.argv[2], sys.argv[2:])


if __name__ == '__main__':
    main()
