"""PX4's poses as the rig's odometry."""

from __future__ import annotations

from nav_msgs.msg import Odometry

from av_common.clock import SenderClock
from av_px4.continuity import ContinuousPose
from av_px4.frames import Pose
from av_px4.messages import odometry_message


class OdometryConverter:
    """Odometry in a frame that never jumps, stamped in ROS time.

    PX4's clock is another one, and lags even when it is synchronised: the offset between both clocks is the smallest
    difference between arrival and stamp.

    Parameters:
        odom_frame: frame of the poses
        base_frame: frame of the rig's body, to which the twist refers
    """

    def __init__(self, odom_frame: str, base_frame: str) -> None:
        self._frames = (odom_frame, base_frame)
        self._pose, self._clock = ContinuousPose(), SenderClock()

    @property
    def clock_restarts(self) -> int:
        """Number of jumps of PX4's clock, which sets it when it loses or regains time synchronisation."""
        return self._clock.restarts

    @property
    def resets(self) -> int:
        """Number of corrections of heading or position by PX4's estimator."""
        return self._pose.resets

    def convert(self, time: float, arrival: float, pose: Pose, counter: int) -> Odometry | None:
        """The message for a pose, None where the stamp cannot be dated: after a jump of PX4's clock, for half a second.

        Parameters:
            time (s): when the pose was valid, on PX4's clock
            arrival (s): when it arrived, in ROS time
            pose: in the estimator's frame
            counter: the estimator's count of resets
        """
        stamp = self._clock.date(time, arrival)
        if stamp is None:
            return None
        return odometry_message(stamp, *self._frames, self._pose.add(time, pose, counter))
