"""Motion of the simulated rig: by its scenario with commanded yaw rates and gimbal angles, or at poses of an autopilot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from av_common.rig import GimbalMount
from av_sim_bridge.vehicle import VehicleState
from av_simulator.motion.axes import SimulatedGimbal, YawAxis, YawResponse
from av_simulator.motion.bodies import MOST_SPEED, Gusts, Kinematics, Pursuit
from av_simulator.scenario import RigMotion
from av_simulator.sound.noise import Wind
from av_simulator.trajectories import Position, acceleration, velocity

SAMPLES_PER_SECOND = 300  # of the motion: 160 samples of sound at 48 kHz


@dataclass(frozen=True)
class SampledMotion:
    """Motion through samples, position as cubic polynomials, attitude on the shortest turns. It rests before and after.

    Parameters:
        times (s, (k,)): times of the samples, strictly increasing, at least two.
        positions (m, (k, 3)), velocities (m/s, (k, 3)), accelerations (m/s^2, (k, 3)): in ENU.
        rotations ((k, 3, 3)): from the body (FLU) to ENU.
    """

    times: NDArray
    positions: NDArray
    velocities: NDArray
    accelerations: NDArray
    rotations: NDArray

    def poses(self, times: ArrayLike) -> tuple[NDArray, NDArray]:
        """Positions (k, 3) in ENU and rotations (k, 3, 3) from the body to ENU at times (s, (k,))."""
        t = np.clip(np.atleast_1d(np.asarray(times, float)), self.times[0], self.times[-1])
        return self._path(t), self._attitude(t).as_matrix()

    def state(self, time: float) -> VehicleState:
        """The state at a time (s)."""
        t = float(np.clip(time, self.times[0], self.times[-1]))
        acceleration, rate = (np.array([np.interp(t, self.times, column) for column in values.T])
                              for values in (self.accelerations, self._rates))
        return VehicleState(time, self._path(t), self._path(t, 1), acceleration,
                            self._attitude(t).as_quat()[[3, 0, 1, 2]], rate)

    @cached_property
    def _path(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.times, self.positions, self.velocities)

    @cached_property
    def _attitude(self) -> Slerp:
        return Slerp(self.times, Rotation.from_matrix(self.rotations))

    @cached_property
    def _rates(self) -> NDArray:
        """Angular rates (rad/s, (k, 3)) in FLU at the samples: means of those before and after, continued at both ends."""
        attitudes = Rotation.from_matrix(self.rotations)
        between = (attitudes[:-1].inv() * attitudes[1:]).as_rotvec() / np.diff(self.times)[:, np.newaxis]
        if len(between) == 1:
            return np.repeat(between, 2, axis=0)
        ends = 1.5 * between[[0, -1]] - 0.5 * between[[1, -2]]
        return np.concatenate([ends[:1], 0.5 * (between[:-1] + between[1:]), ends[1:]])


class RigDynamics:
    """Motion of the rig in steps.

    Commands take effect in the next step. After the first pose of another simulator or an autopilot (`follow`), the rig moves
    to the newest such pose instead, at MOST_SPEED at most however far that is, and stays there.

    Attributes:
        motion: the motion within the newest step.
        gimbal: None for a rig without one.

    Parameters:
        motion: trajectory, body, initial yaw and limits of the scenario.
        targets: trajectories of the targets, one of which may be pursued.
        wind: wind that moves the body; None for calm air.
        gimbal: how the gimbal is mounted.
        seed: seed of the gusts.
    """

    def __init__(self, motion: RigMotion, targets: Sequence[Position] = (), wind: Wind | None = None,
                 gimbal: GimbalMount | None = None, seed: int = 0) -> None:
        self._settings, self._targets = motion, targets
        self._yaw = YawAxis(YawResponse(math.radians(motion.max_yaw_rate_deg), math.radians(motion.max_yaw_acceleration_deg),
                                        motion.yaw_dead_time, motion.yaw_lag),
                            math.radians(motion.yaw_deg), math.radians(motion.yaw_rate_deg))
        self._wind = Gusts(wind.velocity if wind else (0.0, 0.0, 0.0), wind.gusts if wind else 0.0, [seed, 17])
        self._pursued: Kinematics | None = None
        self._followed: VehicleState | None = None
        self.gimbal = None if gimbal is None else SimulatedGimbal(gimbal)
        begin = self._path(np.zeros(1))[0]
        self._now, self._body = motion.body.begin(begin, self._air(1.0 / SAMPLES_PER_SECOND, begin))
        self._heading = self._yaw.angle
        self.motion = self._sampled(np.array([-1.0 / SAMPLES_PER_SECOND, 0.0]), [self._now] * 2, [self._heading] * 2)

    def command(self, yaw_rate: float, time: float) -> None:
        """Set the target of the yaw rate.

        Parameters:
            yaw_rate (rad/s): counter-clockwise.
            time (s): simulated time of the command.
        """
        self._yaw.command(yaw_rate, time)

    def look(self, pan: float, tilt: float, time: float) -> None:
        """Set the direction of the gimbal, if there is one: see `SimulatedGimbal.command`."""
        if self.gimbal is not None:
            self.gimbal.command(pan, tilt, time, self.motion.state(time).attitude_wxyz)

    def follow(self, state: VehicleState) -> None:
        """Set the pose given by another simulator or an autopilot."""
        self._followed = state

    def step(self, begin: float, end: float) -> SampledMotion:
        """The motion in the interval from `begin` to `end` (s)."""
        times = np.linspace(begin, end, max(round((end - begin) * SAMPLES_PER_SECOND), 1) + 1)
        self.motion = self._flown(times) if self._followed is None else self._towards(self._followed, times)
        if self.gimbal is not None:
            self.gimbal.step(times)
        return self.motion

    def _flown(self, times: NDArray) -> SampledMotion:
        """The motion of the scenario through `times` (s), which begins where the step before ended."""
        states, headings = [self._now], [self._heading]
        for dt, time, path in zip(np.diff(times).tolist(), times[1:].tolist(), self._path(times[1:]), strict=True):
            pursuit = self._settings.pursuit
            wanted = path if pursuit is None or time < pursuit.begin else self._behind_target(pursuit, dt, time)
            states.append(self._body(dt, wanted, self._air(dt, states[-1])))
            headings.append(self._yaw.step(dt, time))
        self._now, self._heading = states[-1], headings[-1]
        return self._sampled(times, states, headings)

    def _path(self, times: NDArray) -> list[Kinematics]:
        """Where the scenario's trajectory is at times (s)."""
        path = self._settings.trajectory
        return [Kinematics(*row) for row in zip(path(times), velocity(path, times), acceleration(path, times), strict=True)]

    def _behind_target(self, pursuit: Pursuit, dt: float, time: float) -> Kinematics:
        """Where a pursuit leads at a time (s), `dt` (s) after the step before."""
        self._pursued = pursuit.path(self._targets[pursuit.target], self._pursued or self._now, dt, time)
        return self._pursued

    def _air(self, dt: float, state: Kinematics) -> NDArray:
        return self._wind.step(dt, float(state.position[2]), state.velocity)

    def _sampled(self, times: NDArray, states: list[Kinematics], headings: list[float]) -> SampledMotion:
        """The motion through states and headings (rad) at times (s), with vibration."""
        positions, velocities, accelerations, up = (np.array(column) for column in zip(*states, strict=True))
        rotations = attitudes(up, np.array(headings))
        vibration = self._settings.vibration
        if vibration is not None:
            moved = (np.einsum('kij,kj->ki', rotations, part) for part in vibration.moved(times))
            positions, velocities, accelerations = (
                steady + part for steady, part in zip((positions, velocities, accelerations), moved, strict=True))
            rotations = rotations @ Rotation.from_rotvec(vibration.turned(times)).as_matrix()
        return SampledMotion(times, positions, velocities, accelerations, rotations)

    def _towards(self, given: VehicleState, times: NDArray) -> SampledMotion:
        """Motion at constant velocity and angular rate from the present pose to a given one, at MOST_SPEED at most."""
        positions, rotations = self.motion.poses(times[:1])
        way, duration = given.position - positions[0], times[-1] - times[0]
        reached = min(1.0, MOST_SPEED * duration / max(float(np.linalg.norm(way)), 1e-9))
        speed = reached * way / duration
        turned = Slerp(times[[0, -1]], Rotation.concatenate([
            Rotation.from_matrix(rotations[0]), Rotation.from_quat(given.attitude_wxyz[[1, 2, 3, 0]])]))
        return SampledMotion(times, positions + (times - times[0])[:, np.newaxis] * speed, np.tile(speed, (len(times), 1)),
                             np.zeros((len(times), 3)), turned(times).as_matrix())


def attitudes(up: NDArray, headings: NDArray) -> NDArray:
    """Rotation matrices (k, 3, 3) from FLU to ENU of bodies with given z axes.

    Parameters:
        up ((k, 3)): unit vectors of the z axes in ENU, not horizontal.
        headings (rad, (k,)): directions of the x axes seen from above, counter-clockwise from east.
    """
    left = np.cross(up, np.stack([np.cos(headings), np.sin(headings), np.zeros_like(headings)], axis=1))
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    return np.stack([np.cross(left, up), left, up], axis=2)
