"""True state of one vehicle (RFlySim's `SOut2Simulator`), in the long and the short layout."""

import struct
from dataclasses import dataclass, field

import numpy as np
from transforms3d.euler import euler2quat

from av_common.frames import is_orientation
from av_sim_bridge.wire.error import (
    FARTHEST_M,
    FASTEST_M_S,
    MOST_ACCELERATION_M_S2,
    MOST_ANGLE_RAD,
    MOST_RATE_RAD_S,
    MOST_RPM,
    WireError,
    check_magic,
    check_number,
    check_time,
    check_within,
    unpack,
)

LONG_MAGIC = 123456789  # RFlySim's
SHORT_MAGIC = 1234567891  # RFlySim's
_LONG = struct.Struct('<4i24f7d')
_SHORT = struct.Struct('<6i14f4d')
_MOTORS = 8  # speeds in RFlySim's states
_MOST_GPS = 1e10    # not used, in whatever unit
_LIMITS = {'position_ned': FARTHEST_M, 'velocity_ned': FASTEST_M_S, 'euler_rad': MOST_ANGLE_RAD,
           'motor_rpm': MOST_RPM, 'acceleration_frd': MOST_ACCELERATION_M_S2, 'rate_frd': MOST_RATE_RAD_S, 'gps': _MOST_GPS}


@dataclass(frozen=True)
class VehicleTruth:
    """State of one vehicle: position and velocity in NED, attitude as the rotation from FRD to NED.

    Parameters:
        copter_id: number of the vehicle in the simulator.
        vehicle_type: RFlySim's type of the vehicle.
        time (s): time of the state on the sender's clock.
        position_ned (m, (3,)): position.
        velocity_ned (m/s, (3,)): velocity.
        euler_rad (rad, (3,)): roll, pitch, yaw.
        quaternion_wxyz ((4,)): attitude (w, x, y, z).
        motor_rpm (1/min, (8,)): motor speeds.
        acceleration_frd (m/s^2, (3,)): acceleration, zero in the short layout.
        rate_frd (rad/s, (3,)): angular rate, zero in the short layout.
        gps (deg, deg, m, (3,)): latitude, longitude, altitude.
    """

    copter_id: int
    vehicle_type: int
    time: float
    position_ned: np.ndarray
    velocity_ned: np.ndarray
    euler_rad: np.ndarray
    quaternion_wxyz: np.ndarray
    motor_rpm: np.ndarray
    acceleration_frd: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rate_frd: np.ndarray = field(default_factory=lambda: np.zeros(3))
    gps: np.ndarray = field(default_factory=lambda: np.zeros(3))


def encode_truth(truth: VehicleTruth) -> bytes:
    """The 168 bytes of a state in the long layout."""
    return _LONG.pack(LONG_MAGIC, truth.copter_id, truth.vehicle_type, 0, *truth.velocity_ned, *truth.euler_rad,
                      *truth.quaternion_wxyz, *truth.motor_rpm, *truth.acceleration_frd, *truth.rate_frd, truth.time,
                      *truth.position_ned, *truth.gps)


def is_truth(datagram: bytes) -> bool:
    """Whether a datagram has the length of either layout."""
    return len(datagram) in (_LONG.size, _SHORT.size)


def decode_truth(datagram: bytes) -> VehicleTruth:
    """Decode either layout, distinguished by size and magic number. Raises WireError."""
    truth = _decode_short(datagram) if len(datagram) == _SHORT.size else _decode_long(datagram)
    check_truth(truth)
    return truth


def check_truth(truth: VehicleTruth) -> None:
    """Raise WireError for a state whose numbers are not within their limits."""
    check_number(truth.copter_id, 'truth: copter id')
    check_time(truth.time, 'truth')
    for name, limit in _LIMITS.items():
        check_within(getattr(truth, name), limit, f'truth: {name}')
    if not is_orientation(truth.quaternion_wxyz):
        raise WireError(f'truth: quaternion has norm {np.linalg.norm(truth.quaternion_wxyz):.3g}, expected 1')


def _decode_long(datagram: bytes) -> VehicleTruth:
    fields = unpack(_LONG, datagram, 'truth')
    check_magic(fields[0], LONG_MAGIC, 'truth')
    reals = np.array(fields[4:28])
    velocity, euler, quaternion, rpm, acceleration, rate = np.split(reals, np.cumsum([3, 3, 4, _MOTORS, 3]))
    return VehicleTruth(fields[1], fields[2], fields[28], np.array(fields[29:32]), velocity, euler, quaternion, rpm,
                        acceleration, rate, np.array(fields[32:35]))


def _decode_short(datagram: bytes) -> VehicleTruth:
    fields = unpack(_SHORT, datagram, 'truth')
    check_magic(fields[0], SHORT_MAGIC, 'truth')
    rpm, velocity, euler = np.split(np.array(fields[6:20]), [_MOTORS, _MOTORS + 3])
    check_within(euler, MOST_ANGLE_RAD, 'truth: euler_rad')
    return VehicleTruth(fields[1], fields[2], fields[23], np.array(fields[20:23]), velocity, euler,
                        np.array(euler2quat(*euler)), rpm, gps=np.array(fields[3:6]) / [1e7, 1e7, 1e3])
