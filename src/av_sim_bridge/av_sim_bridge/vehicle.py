"""States of vehicles in ROS's frames, and to and from the wire's NED/FRD."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from transforms3d.euler import quat2euler
from transforms3d.quaternions import quat2mat

from av_common.frames import attitude_ned_to_enu, frd_to_flu, ned_to_enu
from av_sim_bridge.wire.imu import ImuSample
from av_sim_bridge.wire.truth import VehicleTruth

GRAVITY = 9.80665


@dataclass(frozen=True)
class VehicleState:
    """State of a vehicle at one time, in ENU and FLU.

    Parameters:
        time (s): of the state.
        position (m, ENU): (3,).
        velocity (m/s, ENU): (3,).
        acceleration (m/s^2, ENU): (3,).
        attitude_wxyz: unit quaternion from FLU to ENU, (4,).
        rate_flu (rad/s, FLU): turn rate, (3,).
        rotor_rpm (1/min): rotor speeds, (8,).
    """

    time: float
    position: NDArray
    velocity: NDArray = field(default_factory=lambda: np.zeros(3))
    acceleration: NDArray = field(default_factory=lambda: np.zeros(3))
    attitude_wxyz: NDArray = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    rate_flu: NDArray = field(default_factory=lambda: np.zeros(3))
    rotor_rpm: NDArray = field(default_factory=lambda: np.zeros(8))

    @property
    def rotation(self) -> NDArray:
        """Rotation matrix (3, 3) from the body (FLU) to the world (ENU)."""
        return quat2mat(self.attitude_wxyz)


def to_truth(state: VehicleState, copter_id: int, vehicle_type: int = 3) -> VehicleTruth:
    """The state as RFlySim sends it."""
    attitude = attitude_ned_to_enu(state.attitude_wxyz)
    acceleration_flu = state.rotation.T @ state.acceleration
    return VehicleTruth(copter_id, vehicle_type, state.time, ned_to_enu(state.position), ned_to_enu(state.velocity),
                        np.array(quat2euler(attitude)), attitude, state.rotor_rpm, frd_to_flu(acceleration_flu),
                        frd_to_flu(state.rate_flu))


def from_truth(truth: VehicleTruth) -> VehicleState:
    """RFlySim's state in ROS's frames; acceleration and turn rate are zero where the layout has none."""
    attitude = attitude_ned_to_enu(truth.quaternion_wxyz / np.linalg.norm(truth.quaternion_wxyz))
    acceleration = np.zeros(3) if truth.acceleration_frd is None else frd_to_flu(truth.acceleration_frd)
    rate = np.zeros(3) if truth.rate_frd is None else frd_to_flu(truth.rate_frd)
    return VehicleState(truth.time, ned_to_enu(truth.position_ned), ned_to_enu(truth.velocity_ned),
                        quat2mat(attitude) @ acceleration, attitude, rate, truth.motor_rpm)


def to_imu(state: VehicleState, sequence: int) -> ImuSample:
    """What an ideal accelerometer and gyroscope on the vehicle measure: specific force and turn rate in FRD."""
    specific_force = state.rotation.T @ (state.acceleration + np.array([0.0, 0.0, GRAVITY]))
    return ImuSample(sequence, state.time, frd_to_flu(specific_force), frd_to_flu(state.rate_flu))
