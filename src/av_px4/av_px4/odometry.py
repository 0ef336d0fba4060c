"""PX4's poses as the rig's odometry, and the speeds of its motors, which hearing needs over its own rotors."""

from __future__ import annotations

import math
from typing import Any

from nav_msgs.msg import Odometry
from std_msgs.msg import Header

from av_common.clock import SenderClock
from av_common.frames import BASE_FRAME, ODOM_FRAME
from av_common.pose_messages import odometry_message
from av_common.stamps import to_stamp
from av_px4.continuity import ContinuousPose
from av_px4.frames import Pose

SYNCHRONISATION_SLEW = 0.02    # s/s, at which PX4's time synchronisation moves its stamps
# s, by which a stamp may precede the clock's offset. A start of the whole rig, seconds of other load, or stalls of the agent
# (up to 0.8 s flown) delay what comes; when it is on time again it is no restart of the clock, which would cost a second.
EARLY_S = 0.9
RADIANS_PER_RPM = 2.0 * math.pi / 60.0  # rad/s of a revolution a minute
LARGEST = 1e4    # rad/s, more than any propeller's motor turns: such a number is none


def px4_clock() -> SenderClock:
    """A clock for stamps of PX4, which nobody but its agent sends."""
    return SenderClock(SYNCHRONISATION_SLEW, EARLY_S)


class OdometryConverter:
    """Converts poses to Odometry messages in a continuous frame, stamped in ROS time.

    PX4's stamps are seconds since boot while its time synchronisation is lost, lag or lead while it converges, and are never
    taken for ROS time: the offset follows from their arrivals alone. After a jump it is known again after a second.

    Attributes:
        pose: the continuous frame, with the estimator's corrections of heading and position.
        clock: PX4's clock, which jumps when time synchronisation is lost or regained; poses that it refuses are not published.
    """

    def __init__(self) -> None:
        self.pose, self.clock = ContinuousPose(), px4_clock()

    def convert(self, time: float, arrival: float, pose: Pose, counter: int) -> Odometry | None:
        """The message of a pose, None when it cannot be dated: at the start and after a jump, for a second each.

        Parameters:
            time (s): time of validity of the pose, on PX4's clock
            arrival (s): time of arrival, ROS time
            pose: pose in the estimator's frame
            counter: the estimator's reset counter
        """
        stamp = self.clock.date(time, arrival)
        if stamp is None:
            return None
        continuous = self.pose.add(time, pose, counter)
        return odometry_message(Header(stamp=to_stamp(stamp), frame_id=ODOM_FRAME), BASE_FRAME, continuous.position,
                                continuous.attitude_wxyz, continuous.velocity_flu, continuous.rate_flu)


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
    return speed if speed <= LARGEST else math.nan
