"""Motion of the simulated rig: along its scenario's trajectory with commanded yaw rates, or at poses of an autopilot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from av_sim_bridge.vehicle import VehicleState
from av_simulator.scenario import RigMotion
from av_simulator.trajectories import Position, acceleration, velocity

COMMAND_LIFETIME = 0.2   # s, age of the newest command from which the rig brakes
MOST_SPEED = 60.0        # m/s, speed at which the rig goes to a given pose at most; sound allows 0.4 of its speed together


@dataclass(frozen=True)
class Turn:
    """Yaw with a constant target rate, counter-clockwise.

    Parameters:
        start (s): start of the turn.
        yaw0 (rad): yaw at the start.
        rate0 (rad/s): yaw rate at the start.
        aim (rad/s): target of the yaw rate.
        acceleration (rad/s^2): yaw acceleration until the target is reached.
    """

    start: float
    yaw0: float
    rate0: float
    aim: float
    acceleration: float

    def rate(self, times: ArrayLike) -> NDArray:
        """Yaw rates (rad/s) at times (s), not before `start`."""
        reach = self.acceleration * (np.asarray(times, float) - self.start)
        return self.rate0 + np.clip(self.aim - self.rate0, -reach, reach)

    def yaw(self, times: ArrayLike) -> NDArray:
        """Yaw (rad) at times (s), not before `start`: a ramp of the rate, then a constant rate."""
        elapsed = np.asarray(times, float) - self.start
        change = self.aim - self.rate0
        ramp = np.minimum(elapsed, abs(change) / self.acceleration)
        ramped = self.rate0 * ramp + np.sign(change) * self.acceleration * ramp**2 / 2
        return self.yaw0 + ramped + self.aim * (elapsed - ramp)


@dataclass(frozen=True)
class PlannedMotion:
    """Motion along the scenario's trajectory, with a rotation about the vertical.

    Parameters:
        path: function from times (s, (k,)) to positions (m, (k, 3)) in ENU.
        turn: yaw as a function of time.
    """

    path: Position
    turn: Turn

    def poses(self, times: ArrayLike) -> tuple[NDArray, NDArray]:
        """Positions (k, 3) in ENU and rotations (k, 3, 3) from the body to ENU at times (k,)."""
        t = np.atleast_1d(np.asarray(times, float))
        turned = np.zeros((len(t), 3))
        turned[:, 2] = self.turn.yaw(t)
        return self.path(t), Rotation.from_rotvec(turned).as_matrix()

    def state(self, time: float) -> VehicleState:
        """The rig's state at a time."""
        yaw = float(self.turn.yaw(time))
        return VehicleState(time, self.path(time)[0], velocity(self.path, time)[0], acceleration(self.path, time)[0],
                            np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]),
                            np.array([0.0, 0.0, float(self.turn.rate(time))]))


@dataclass(frozen=True)
class FollowedMotion:
    """Motion from one pose to the next at constant velocity and angular rate.

    Parameters:
        begin, end (s): interval of the motion.
        position0, position1 (m, (3,)): positions in ENU at its begin and end.
        rotation0, rotation1: rotations from the body to ENU at its begin and end.
    """

    begin: float
    end: float
    position0: NDArray
    rotation0: Rotation
    position1: NDArray
    rotation1: Rotation

    def poses(self, times: ArrayLike) -> tuple[NDArray, NDArray]:
        """Positions (k, 3) in ENU and rotations (k, 3, 3) from the body to ENU at times (k,)."""
        share = (np.atleast_1d(np.asarray(times, float)) - self.begin) / (self.end - self.begin)
        turned = Rotation.from_rotvec(share[:, np.newaxis] * self._turned)
        return (self.position0 + share[:, np.newaxis] * (self.position1 - self.position0),
                (self.rotation0 * turned).as_matrix())

    def state(self, time: float) -> VehicleState:
        """The rig's state at a time."""
        positions, rotations = self.poses([time])
        duration = self.end - self.begin
        return VehicleState(time, positions[0], (self.position1 - self.position0) / duration,
                            attitude_wxyz=Rotation.from_matrix(rotations[0]).as_quat()[[3, 0, 1, 2]],
                            rate_flu=self._turned / duration)

    @property
    def _turned(self) -> NDArray:
        """Rotation vector (rad, (3,)) of the whole motion in the body frame."""
        return (self.rotation0.inv() * self.rotation1).as_rotvec()


class RigDynamics:
    """Motion of the rig in steps.

    Commanded yaw rates take effect in the next step. After the first pose of another simulator or an autopilot (`follow`),
    the rig moves to the newest such pose instead, at MOST_SPEED at most however far that is, and stays there.

    Parameters:
        motion: trajectory, initial yaw and limits of the scenario.
    """

    def __init__(self, motion: RigMotion):
        self._limit = np.deg2rad(motion.max_yaw_rate_deg)
        self._acceleration = np.deg2rad(motion.max_yaw_acceleration_deg)
        self._planned_rate: float | None = np.deg2rad(motion.yaw_rate_deg)   # until the first command
        self._command, self._commanded = 0.0, -np.inf
        self._followed: VehicleState | None = None
        rate = float(np.clip(self._planned_rate, -self._limit, self._limit))
        turn = Turn(0.0, float(np.deg2rad(motion.yaw_deg)), rate, rate, self._acceleration)
        self._plan = PlannedMotion(motion.trajectory, turn)
        self.motion: PlannedMotion | FollowedMotion = self._plan

    def command(self, yaw_rate: float, time: float) -> None:
        """Set the target of the yaw rate.

        Parameters:
            yaw_rate (rad/s): counter-clockwise.
            time (s): simulated time of the command.
        """
        self._planned_rate = None
        self._command, self._commanded = yaw_rate, time

    def follow(self, state: VehicleState) -> None:
        """Set the pose given by another simulator or an autopilot."""
        self._followed = state

    def step(self, begin: float, end: float) -> PlannedMotion | FollowedMotion:
        """The motion in the interval from `begin` to `end` (s)."""
        if self._followed is None:
            self.motion = self._plan = PlannedMotion(self._plan.path, self._turn(begin))
        else:
            positions, rotations = self.motion.poses([begin])
            attitude = Rotation.from_quat(self._followed.attitude_wxyz[[1, 2, 3, 0]])
            way = self._followed.position - positions[0]
            reached = min(1.0, MOST_SPEED * (end - begin) / max(float(np.linalg.norm(way)), 1e-9))
            self.motion = FollowedMotion(begin, end, positions[0], Rotation.from_matrix(rotations[0]),
                                         positions[0] + reached * way, attitude)
        return self.motion

    def _turn(self, start: float) -> Turn:
        if self._planned_rate is not None:
            aim = self._planned_rate
        else:
            aim = self._command if start - self._commanded <= COMMAND_LIFETIME else 0.0
        aim = float(np.clip(aim, -self._limit, self._limit))
        turn = self._plan.turn
        return Turn(start, float(turn.yaw(start)), float(turn.rate(start)), aim, self._acceleration)
