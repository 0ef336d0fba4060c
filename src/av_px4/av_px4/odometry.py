"""PX4's poses as the rig's odometry, the position that is held, and speeds of motors, which hearing needs over own rotors.

PX4's frames are NED and FRD with clockwise yaw; those of ROS are ENU and FLU with counter-clockwise yaw.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from transforms3d.axangles import axangle2mat
from transforms3d.quaternions import axangle2quat, qmult, quat2mat

from av_common.angles import wrap
from av_common.clock import SenderClock
from av_common.frames import attitude_ned_to_enu, checked_orientation, frd_to_flu, ned_to_enu, yaw_of

Floats: TypeAlias = Sequence[float] | NDArray
# px4_msgs/VehicleOdometry's numbers of frames.
POSE_FRAME_NED = 1
VELOCITY_FRAME_NED, VELOCITY_FRAME_FRD, VELOCITY_FRAME_BODY_FRD = 1, 2, 3
LARGEST = 1e6    # m, m/s, rad/s; a larger number is no pose
UP = (0.0, 0.0, 1.0)
LONGEST_GAP = 0.5  # s, longest interval over which a pose is extrapolated by its own rates
SYNCHRONISATION_SLEW = 0.02    # s/s, at which PX4's time synchronisation moves its stamps
# s, by which a stamp may precede the clock's offset. A start of the whole rig, seconds of other load, or stalls of the agent
# (up to 0.8 s flown) delay what comes; when it is on time again it is no restart of the clock, which would cost a second.
EARLY_S = 0.9
RADIANS_PER_RPM = 2.0 * math.pi / 60.0  # rad/s of a revolution a minute
FASTEST_MOTOR = 1e4    # rad/s, more than any propeller's motor turns: such a number is none


@dataclass(frozen=True)
class Pose:
    """Pose and twist of the vehicle in ROS's frames.

    Parameters:
        position (m, (3,)): position in ENU
        attitude_wxyz ((4,)): quaternion (w, x, y, z) of the rotation from FLU to ENU
        velocity_flu (m/s, (3,)): velocity in the body frame
        rate_flu (rad/s, (3,)): angular rate in the body frame
    """

    position: NDArray
    attitude_wxyz: NDArray
    velocity_flu: NDArray
    rate_flu: NDArray

    @property
    def yaw(self) -> float:
        """Heading, rad, counter-clockwise from east."""
        return yaw_of([float(part) for part in self.attitude_wxyz])


def pose_from_px4(position_ned: Floats, attitude: Floats, velocity: Floats, rate_frd: Floats,
                  pose_frame: int = POSE_FRAME_NED, velocity_frame: int = VELOCITY_FRAME_NED) -> Pose:
    """Pose in ROS frames. Unknown values (NaN) become 0, except in the attitude.

    Raises ValueError for a quaternion that is not of norm 1, a frame that is not NED, or a number beyond LARGEST.

    Parameters:
        position_ned (m, (3,)): position in NED
        attitude ((4,)): quaternion (w, x, y, z) of the rotation from FRD to NED
        velocity (m/s, (3,)): velocity in the frame given by `velocity_frame`
        rate_frd (rad/s, (3,)): angular rate in the body frame
        pose_frame: VehicleOdometry's constant of the frame of position and attitude
        velocity_frame: VehicleOdometry's constant of the frame of the velocity; an unknown frame gives 0 m/s
    """
    if pose_frame != POSE_FRAME_NED:
        raise ValueError(f'pose_frame is {pose_frame}, expected {POSE_FRAME_NED} (NED)')
    enu = attitude_ned_to_enu(checked_orientation(attitude, 'attitude'))
    numbers = np.nan_to_num(np.array([position_ned, velocity, rate_frd], float))
    if np.abs(numbers).max() > LARGEST:
        raise ValueError(f'a pose of {np.abs(numbers).max():.3g} m, m/s or rad/s, expected at most {LARGEST:g}')
    position, velocity, rate = numbers
    velocity_flu = (quat2mat(enu).T @ ned_to_enu(velocity) if velocity_frame == VELOCITY_FRAME_NED
                    else frd_to_flu(velocity) if velocity_frame == VELOCITY_FRAME_BODY_FRD else np.zeros(3))
    return Pose(ned_to_enu(position), enu, velocity_flu, frd_to_flu(rate))


class ContinuousPose:
    """Poses in a continuous frame (REP-105 `odom`), with the estimator's resets removed.

    PX4 counts its resets. The size of a reset is the difference between the newest pose and the previous one, extrapolated
    by its own rates. This needs no second topic, and therefore no order of arrival between topics.
    """

    def __init__(self) -> None:
        self.resets = 0
        self._last: tuple[float, Pose, int] | None = None
        self._turn = 0.0            # rad, rotation about z from the estimator's frame to the continuous frame
        self._shift = np.zeros(3)   # m, translation after the rotation

    def add(self, time: float, pose: Pose, counter: int) -> Pose:
        """Pose in the continuous frame.

        Parameters:
            time (s): time of validity of the pose, on any clock that runs evenly
            pose: pose in the estimator's frame
            counter: the estimator's reset counter at that time
        """
        if self._last is not None and counter != self._last[2] and 0.0 <= time - self._last[0] <= LONGEST_GAP:
            self._correct(time - self._last[0], self._last[1], pose)
        self._last = (time, pose, counter)
        return self._moved(pose)

    def _correct(self, dt: float, before: Pose, after: Pose) -> None:
        yaw = before.yaw + before.rate_flu[2] * dt
        moved = self._moved(before)
        expected = moved.position + quat2mat(moved.attitude_wxyz) @ moved.velocity_flu * dt
        self._turn = float(wrap(self._turn + float(wrap(yaw - after.yaw))))
        self._shift = expected - axangle2mat(UP, self._turn) @ after.position
        self.resets += 1

    def _moved(self, pose: Pose) -> Pose:
        if not self.resets:
            return pose
        attitude = qmult(axangle2quat(UP, self._turn), pose.attitude_wxyz)
        return Pose(axangle2mat(UP, self._turn) @ pose.position + self._shift, attitude, pose.velocity_flu, pose.rate_flu)


def px4_clock() -> SenderClock:
    """A clock for stamps of PX4, which nobody but its agent sends.

    They are seconds since boot while PX4's time synchronisation is lost, lag or lead while it converges, and are never taken
    for ROS time: the offset follows from their arrivals alone. After a jump it is known again after a second.
    """
    return SenderClock(SYNCHRONISATION_SLEW, EARLY_S)


class HeldPosition:
    """The position to hold, in the estimator's frame (NED). A reset of the estimator shifts it by the same amount.

    After several resets at once, of which only the newest is known, it is the position of that time.
    """

    def __init__(self) -> None:
        self.current: NDArray | None = None   # m (3,), newest valid position, None without one
        self.held: NDArray | None = None      # m (3,), position that is held, None while not holding
        self._counters: tuple[int, int] | None = None

    def update(self, position: NDArray, counters: tuple[int, int], corrections: NDArray, valid: bool) -> None:
        """Process a position of the vehicle.

        Parameters:
            position (m, (3,)): position in the estimator's frame (NED)
            counters: the estimator's reset counters, horizontal and vertical
            corrections (m, (3,)): shift of the position by the newest resets
            valid: whether the estimator declares the position valid
        """
        if not (valid and np.all(np.isfinite(position))):
            self.current = None
            return
        if self.held is not None and self._counters is not None:
            horizontal, vertical = ((new - old) % 256 for new, old in zip(counters, self._counters, strict=True))
            if max(horizontal, vertical) > 1:    # the shift by a reset before the newest was missed
                self.release()
            else:
                self.held = self.held + np.nan_to_num(corrections) * np.array([horizontal, horizontal, vertical])
        self.current, self._counters = np.array(position, float), counters

    def hold(self) -> NDArray | None:
        """Position to hold (m, (3,)): the vehicle's at the first call since `release`; None without a valid position."""
        if self.held is None:
            self.held = self.current
        return self.held

    def release(self) -> None:
        """Stop holding; the next call of `hold` selects the position of that time."""
        self.held = None


def measured_speeds(message: Any) -> list[float]:
    """Speeds (rad/s) that the controllers of the motors report in an EscStatus, NaN for one that is not online."""
    count = min(message.esc_count, len(message.esc))
    return [_usable(RADIANS_PER_RPM * abs(message.esc[number].esc_rpm)) if message.esc_online_flags >> number & 1 else math.nan
            for number in range(count)]


def commanded_speeds(message: Any, full_speed: float) -> list[float]:
    """Speeds (rad/s) that an ActuatorMotors commands, up to the last motor that is commanded.

    A motor's speed is taken as proportional to its signal, which is the command where THR_MDL_FAC is 0, PX4's default.

    Parameters:
        message: the commands, 0 to 1, NaN for motors that stand still or do not exist
        full_speed (rad/s): at a command of 1
    """
    commands = [abs(float(command)) for command in message.control]
    last = max((number for number, command in enumerate(commands, 1) if math.isfinite(command)), default=0)
    return [_usable(full_speed * command) if command <= 1.0 else math.nan if command > 1.0 else 0.0
            for command in commands[:last]]


def _usable(speed: float) -> float:
    return speed if speed <= FASTEST_MOTOR else math.nan
