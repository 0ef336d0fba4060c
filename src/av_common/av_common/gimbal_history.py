"""Orientations of the gimbal over recent time: what is measured goes before what is modelled, and the impossible is refused."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from transforms3d.quaternions import quat2mat

from av_common.frames import BASE_FRAME, attitude_of, checked_orientation
from av_common.freshness import FUTURE_S, is_of_clock
from av_common.quaternions import Quaternion, between, inverse, product, vector_of
from av_common.stamps import to_seconds
from av_common.timeline import Timeline

KEEP_S = 5.0  # of orientations: images are at most a second late
FEEDBACK_TIMEOUT_S = 0.5  # after the newest measured orientation arrived, from which the gimbal counts as silent
GAP_S = 0.06  # after a measured orientation, which the model fills
OLDEST_S = 1.0  # age at arrival of a measured orientation from which it is refused, and none is waited for
NEAREST_S = 0.02  # behind the newest orientation, up to which it is taken for the present one
LARGEST_VARIANCE = 10.0  # rad^2
LEAST_SIGMA = math.radians(0.05)  # of any report: those of a variance of 0 are rounded, too
FASTEST = math.radians(1500.0)  # rad/s, between two measured orientations: gimbal and body together
SUDDEN = math.radians(5.0)  # rad, in addition
PATH = 0.25  # share of the angle between two orientations by which the interpolated one may be wrong
RESTART_S = 1.0  # step of the clock back, as where a bag begins again, after which what is known of a gimbal begins anew


class NotYetKnownError(ValueError):
    """The orientation of a frame at a time for which data may still come."""


class GimbalSample(NamedTuple):
    """Orientation of the gimbal at one time.

    Parameters:
        time (s): the time.
        attitude_wxyz: unit quaternion (w, x, y, z) of the rotation from the gimbal's frame to the body's.
        variance (rad^2): of the error about each axis.
        measured: whether the gimbal reported it.
    """

    time: float
    attitude_wxyz: Quaternion
    variance: float
    measured: bool

    @property
    def rotation(self) -> NDArray[np.float64]:
        """Rotation matrix (3, 3) from the gimbal's frame to the body's."""
        return quat2mat(self.attitude_wxyz)


def sample_of(message: Any, gimbal_frame: str = '') -> GimbalSample:
    """The sample of a `GimbalState`. Raises ValueError for one that cannot be used.

    Parameters:
        message: the message.
        gimbal_frame: the frame that it must be of; any for an empty name.
    """
    for given, expected in ((message.header.frame_id, BASE_FRAME), (message.child_frame_id, gimbal_frame)):
        if expected and given != expected:
            raise ValueError(f'orientation from {message.child_frame_id!r} to {message.header.frame_id!r}, expected from '
                             f'{gimbal_frame!r} to {BASE_FRAME!r}')
    q, variance = checked_orientation(attitude_of(message.orientation), 'orientation'), message.variance
    if not 0.0 <= variance <= LARGEST_VARIANCE:
        raise ValueError(f'variance {variance} rad^2, expected 0 to {LARGEST_VARIANCE:g}')
    if message.source not in (message.SOURCE_MODEL, message.SOURCE_FEEDBACK):
        raise ValueError(f'source {message.source}, expected {message.SOURCE_MODEL} or {message.SOURCE_FEEDBACK}')
    return GimbalSample(to_seconds(message.header.stamp), q, max(variance, LEAST_SIGMA**2),
                        message.source == message.SOURCE_FEEDBACK)


class GimbalHistory:
    """Interpolates between orientations of the gimbal.

    Times of arrival must not decrease, except for a restart of the clock.
    """

    def __init__(self) -> None:
        self._samples: Timeline[GimbalSample] = Timeline(KEEP_S)
        self._arrival = self._feedback_arrival = -math.inf

    @property
    def newest(self) -> GimbalSample | None:
        """The newest orientation."""
        return self._samples.entries[-1][1] if self._samples.entries else None

    def has_feedback(self, now: float) -> bool:
        """Whether a measured orientation has arrived recently, at the time `now` (s)."""
        return now - self._feedback_arrival <= FEEDBACK_TIMEOUT_S

    def has_gap(self, time: float) -> bool:
        """Whether a modelled orientation is of use at a time (s): after the newest, and not soon after a measured one."""
        newest = self.newest
        return newest is None or time > newest.time + (GAP_S if newest.measured else 0.0)

    def add(self, sample: GimbalSample, arrival: float) -> bool:
        """Add an orientation; whether it is used: a modelled one only where measured ones leave a gap.

        Parameters:
            sample: the orientation.
            arrival (s): time of its arrival.

        Raises ValueError for stamps that are old, of the future or not newer than the one before, and for jumps that no
        gimbal can make.
        """
        if arrival < self._arrival - RESTART_S:
            self._samples.clear()
            self._feedback_arrival = -math.inf
        self._arrival = max(arrival, self._arrival) if arrival > self._arrival - RESTART_S else arrival
        if not is_of_clock(sample.time, arrival, OLDEST_S):
            raise ValueError(f'stamp {sample.time - arrival:+.2f} s from its arrival, expected {-OLDEST_S:g} to {FUTURE_S:g} s')
        if not sample.measured:
            if not self.has_gap(sample.time):
                return False
        else:
            self._check(sample)
            self._feedback_arrival = arrival
            while (newest := self.newest) and not newest.measured and newest.time >= sample.time:
                del self._samples.entries[-1]  # modelled ahead
        self._samples.add(sample.time, sample)
        return True

    def _check(self, sample: GimbalSample) -> None:
        before = next((kept for _, kept in reversed(self._samples.entries) if kept.measured), None)
        if before is None:
            return
        elapsed = sample.time - before.time
        if elapsed <= 0.0:
            raise ValueError(f'stamp {-elapsed:.3f} s before its predecessor')
        turned = _angle(before, sample)
        if turned > SUDDEN + FASTEST * elapsed:
            raise ValueError(f'turned by {math.degrees(turned):.0f} deg within {elapsed:.3f} s, which no gimbal can')

    def at(self, time: float) -> GimbalSample | None:
        """The orientation at a time (s); None before the oldest that is kept. Raises NotYetKnownError after the newest."""
        if self.newest is None or time > self.newest.time + NEAREST_S:
            raise NotYetKnownError(f'no orientation of the gimbal at {time:.3f} s yet')
        if time < self._samples.oldest - NEAREST_S:
            return None
        left, right, share = self._samples.around(time)
        if left is right:
            return left
        path = PATH * _angle(left, right)
        nearness = 4.0 * share * (1.0 - share)  # 0 at either end, 1 in the middle
        return GimbalSample(time, between(left.attitude_wxyz, right.attitude_wxyz, share),
                            max(left.variance, right.variance) + nearness * path**2, left.measured and right.measured)

    def variance(self, time: float) -> float:
        """Variance (rad^2) about each axis at a time (s); that of the newest orientation after it, 0 without any."""
        if self.newest is None:
            return 0.0
        sample = self.at(min(time, self.newest.time)) or self._samples.entries[0][1]
        return sample.variance


def _angle(first: GimbalSample, second: GimbalSample) -> float:
    """Angle (rad) of the rotation between two orientations."""
    return math.hypot(*vector_of(product(inverse(first.attitude_wxyz), second.attitude_wxyz)))
