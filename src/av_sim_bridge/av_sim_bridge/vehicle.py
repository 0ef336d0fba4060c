"""States of vehicles in ROS frames (ENU/FLU), and their conversion from and to RFlySim's NED/FRD."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from transforms3d.euler import quat2euler
from transforms3d.quaternions import quat2mat

from av_common.frames import attitude_ned_to_enu, frd_to_flu, ned_to_enu
from av_sim_bridge.wire.imu import ImuSample
from av_sim_bridge.wire.truth import VehicleTruth

GRAVITY = 9.80665  # m/s^2, standard gravity (ISO 80000-3)
QUADROTOR = 3  # RFlySim's type of the vehicle


@dataclass(frozen=True)
class VehicleState:
    """State of a vehicle at one time, in ENU and FLU.

    Parameters:
        time (s): time of the state.
        position (m, (3,)): position in ENU.
        velocity (m/s, (3,)): velocity in ENU.
        acceleration (m/s^2, (3,)): acceleration in ENU, without gravity.
        attitude_wxyz ((4,)): unit quaternion (w, x, y, z) of the rotation from FLU to ENU.
        rate_flu (rad/s, (3,)): angular rate in FLU.
        rotor_rpm (1/min, (8,)): rotor speeds.
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


def to_truth(state: VehicleState, copter_id: int) -> VehicleTruth:
    """The state in RFlySim's frames.

    Parameters:
        state: state in ENU and FLU.
        copter_id: number of the vehicle in the simulator.
    """
    attitude = attitude_ned_to_enu(state.attitude_wxyz)
    acceleration_flu = state.rotation.T @ state.acceleration
    return VehicleTruth(copter_id, QUADROTOR, state.time, ned_to_enu(state.position), ned_to_enu(state.velocity),
                        np.array(quat2euler(attitude)), attitude, state.rotor_rpm, frd_to_flu(acceleration_flu),
                        frd_to_flu(state.rate_flu))


def from_truth(truth: VehicleTruth) -> VehicleState:
    """RFlySim's state in ROS frames. Acceleration and angular rate are zero for the layout without them."""
    attitude = attitude_ned_to_enu(truth.quaternion_wxyz / np.linalg.norm(truth.quaternion_wxyz))
    return VehicleState(truth.time, ned_to_enu(truth.position_ned), ned_to_enu(truth.velocity_ned),
                        quat2mat(attitude) @ frd_to_flu(truth.acceleration_frd), attitude, frd_to_flu(truth.rate_frd),
                        truth.motor_rpm)


def to_imu(state: VehicleState, sequence: int) -> ImuSample:
    """Output of an ideal accelerometer and gyroscope on the vehicle: specific force and angular rate in FRD.

    Parameters:
        state: state in ENU and FLU.
        sequence: number of the sample.
    """
    specific_force = state.rotation.T @ (state.acceleration + np.array([0.0, 0.0, GRAVITY]))
    return ImuSample(sequence, state.time, frd_to_flu(specific_force), frd_to_flu(state.rate_flu))
