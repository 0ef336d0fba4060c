"""Poses without the jumps that an estimator makes when it corrects its heading or position."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from transforms3d.axangles import axangle2mat
from transforms3d.quaternions import axangle2quat, qmult, quat2mat

from av_common.angles import wrap
from av_px4.frames import Pose

UP = (0.0, 0.0, 1.0)
LONGEST_GAP = 0.5  # s, longest interval over which a pose is extrapolated by its own rates


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
