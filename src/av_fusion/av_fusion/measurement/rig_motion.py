"""The rig's yaw over recent time, so that a late measurement is rotated by the yaw at its capture time."""

from __future__ import annotations

import bisect
import math
from math import remainder, tau


class RigMotion:
    """Interpolates the yaw between recent poses; without poses the rig is assumed to stand still.

    Poses must arrive in order of time: a late one is ignored, so that the buffer stays sorted. After a jump back by more than
    the buffer's length, such as a restarted bag, the buffer is emptied.

    Parameters:
        keep_s (s): length of the buffer.
        extrapolate_s (s): longest extrapolation of the newest pose by its rate.
    """

    def __init__(self, keep_s: float = 5.0, extrapolate_s: float = 0.3) -> None:
        self._keep_s = keep_s
        self._extrapolate_s = extrapolate_s
        self._times: list[float] = []
        self._yaws: list[float] = []   # unwrapped, so that interpolation crosses +-pi
        self._rates: list[float] = []

    def add(self, time: float, yaw: float, yaw_rate: float = 0.0) -> None:
        """Add a pose: yaw in rad (ENU), its rate in rad/s. Implausible values are ignored.

        Parameters:
            time (s): time of the pose.
            yaw (rad): yaw in ENU.
            yaw_rate (rad/s): its rate.
        """
        if not (math.isfinite(time) and abs(yaw) <= 1e4 and abs(yaw_rate) <= 100.0):
            return
        if self._times and time <= self._times[-1]:
            if time > self._times[-1] - self._keep_s:
                return
            self._times, self._yaws, self._rates = [], [], []
        previous = self._yaws[-1] if self._yaws else yaw
        self._times.append(time)
        self._yaws.append(previous + remainder(yaw - previous, tau))
        self._rates.append(yaw_rate)
        if self._times[0] < time - 2.0 * self._keep_s:  # trimmed rarely: cheap, and the buffer stays bounded
            first = bisect.bisect_left(self._times, time - self._keep_s)
            del self._times[:first], self._yaws[:first], self._rates[:first]

    @property
    def newest(self) -> float:
        """Time of the newest pose, -inf before the first."""
        return self._times[-1] if self._times else -math.inf

    def yaw(self, time: float) -> float:
        """Yaw in rad at `time`: interpolated, and shortly beyond the newest pose extrapolated."""
        if not self._times:
            return 0.0
        if time >= self._times[-1]:
            ahead = min(time - self._times[-1], self._extrapolate_s)
            return remainder(self._yaws[-1] + ahead * self._rates[-1], tau)
        after = bisect.bisect_right(self._times, time)
        if after == 0:
            return remainder(self._yaws[0], tau)
        share = (time - self._times[after - 1]) / (self._times[after] - self._times[after - 1])
        return remainder(self._yaws[after - 1] + share * (self._yaws[after] - self._yaws[after - 1]), tau)

    def yaw_rate(self, time: float) -> float:
        """Yaw rate in rad/s of the pose nearest before `time`."""
        if not self._times:
            return 0.0
        return self._rates[max(bisect.bisect_right(self._times, time) - 1, 0)]
