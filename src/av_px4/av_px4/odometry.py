"""PX4's poses as the rig's odometry."""

from __future__ import annotations

from nav_msgs.msg import Odometry

from av_common.clock import SenderClock
from av_px4.continuity import ContinuousPose
from av_px4.frames import Pose
from av_px4.messages import odometry_message


class OdometryConverter:
    """Converts poses to Odometry messages in a continuous frame, stamped in ROS time.

    PX4 has its own clock, which lags even when it is synchronised. The offset between both clocks is estimated as the
    smallest difference between arrival and stamp.

    Parameters:
        odom_frame: frame of the poses
        base_frame: frame of the vehicle's body, to which the twist refers
    """

    def __init__(self, odom_frame: str, base_frame: str) -> None:
        self._frames = (odom_frame, base_frame)
        self._pose, self._clock = ContinuousPose(), SenderClock()

    @property
    def clock_restarts(self) -> int:
        """Number of jumps of PX4's clock; it jumps when time synchronisation is lost or regained."""
        return self._clock.restarts

    @property
    def resets(self) -> int:
        """Number of corrections of heading or position by PX4's estimator."""
        return self._pose.resets

    def convert(self, time: float, arrival: float, pose: Pose, counter: int) -> Odometry | None:
        """The message of a pose, None for half a second after a jump of PX4's clock, when stamps cannot be converted.

        Parameters:
            time (s): time of validity of the pose, on PX4's clock
            arrival (s): time of arrival, ROS time
            pose: pose in the estimator's frame
            counter: the estimator's reset counter
        """
        stamp = self._clock.date(time, arrival)
        if stamp is None:
            return None
        return odometry_message(stamp, *self._frames, self._pose.add(time, pose, counter))
