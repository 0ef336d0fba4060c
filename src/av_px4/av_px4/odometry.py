"""PX4's poses as the rig's odometry."""

from __future__ import annotations

from nav_msgs.msg import Odometry

from av_common.clock import SenderClock
from av_px4.continuity import ContinuousPose
from av_px4.frames import Pose
from av_px4.messages import odometry_message

SYNCHRONISATION_SLEW = 0.02    # s/s, at which PX4's time synchronisation moves its stamps
# s, by which a stamp may precede the clock's offset. A start of the whole rig, seconds of other load, or stalls of the agent
# (up to 0.8 s flown) delay what comes; when it is on time again it is no restart of the clock, which would cost a second.
EARLY_S = 0.9


def px4_clock() -> SenderClock:
    """A clock for stamps of PX4, which nobody but its agent sends."""
    return SenderClock(SYNCHRONISATION_SLEW, EARLY_S)


class OdometryConverter:
    """Converts poses to Odometry messages in a continuous frame, stamped in ROS time.

    PX4's stamps are seconds since boot while its time synchronisation is lost, lag or lead while it converges, and are never
    taken for ROS time: the offset follows from their arrivals alone. After a jump it is known again after a second.
    """

    def __init__(self) -> None:
        self._pose, self._clock = ContinuousPose(), px4_clock()

    @property
    def clock_restarts(self) -> int:
        """Number of jumps of PX4's clock; it jumps when time synchronisation is lost or regained."""
        return self._clock.restarts

    @property
    def undated(self) -> int:
        """Number of poses that could not be dated and were not published."""
        return self._clock.refused

    @property
    def resets(self) -> int:
        """Number of corrections of heading or position by PX4's estimator."""
        return self._pose.resets

    def convert(self, time: float, arrival: float, pose: Pose, counter: int) -> Odometry | None:
        """The message of a pose, None when it cannot be dated: at the start and after a jump, for a second each.

        Parameters:
            time (s): time of validity of the pose, on PX4's clock
            arrival (s): time of arrival, ROS time
            pose: pose in the estimator's frame
            counter: the estimator's reset counter
        """
        stamp = self._clock.date(time, arrival)
        if stamp is None:
            return None
        return odometry_message(stamp, self._pose.add(time, pose, counter))
