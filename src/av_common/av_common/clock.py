"""Clocks of senders and devices: what they stamp or count, as ROS time in s.

Whatever carries a stamp (datagrams of a simulator, messages of PX4, frames of a camera, blocks of an unstamped stream) is
dated by a `SenderClock`: arrival can be late but never early, so the least delay gives the offset between the clocks. A
microphone array's blocks need evenly spaced stamps and the true sample rate: a `SampleClock` fits a line to their
arrivals. Blocks with stamps but without an index get one from a `SampleCounter`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque

# Blocks arrive with a jitter of milliseconds; over this many seconds it averages out and drift still shows.
MEMORY_S = 60.0
# Sample stamps move towards the fit by at most this much per block, so that they are regular from the first one on.
SLEW_S = 2e-5
# Blocks that wait for their reader keep the time they had when they came.
REMEMBERED_BLOCKS = 64
# A busy machine delivers single blocks late by any time; that many in a row mean that the clock was set, and the fit
# starts again. No block comes early: then it was the first one that came late.
LATE_S = 0.05
LATE_BLOCKS = 100
MOST_DRIFT = 2e-3
# The slope counts once the times spread by this standard deviation, after about ten seconds.
SLOPE_SPREAD_S = 3.0
# Streams without a sample index: a stamp further than this from where it was expected is a gap.
GAP_S = 0.02


class CaptureClock(ABC):
    """Maps the time axis of a sender or device to ROS time; `restarts` counts how often the mapping began again."""

    restarts: int = 0

    @abstractmethod
    def observe(self, stamp: float, arrival: float) -> bool:
        """Learn from one arrival (ROS time, s) of what is stamped `stamp`; False where the stamp is refused."""

    @abstractmethod
    def to_ros(self, stamp: float) -> float:
        """ROS time in s of a stamp that was not refused. Raises RuntimeError before the first observation."""

    def date(self, stamp: float, arrival: float) -> float | None:
        """ROS time in s of `stamp`, which arrived at `arrival` (ROS time, s); None where it is refused."""
        return self.to_ros(stamp) if self.observe(stamp, arrival) else None


class SenderClock(CaptureClock):
    """ROS time = stamp + the smallest arrival - stamp seen, which may rise by `drift` seconds a second (Cristian 1989).

    A stamp that is off by more than `restart` seconds is refused, until nothing else came for that long: then the sender
    was started again or was paused, and the clock starts again. One object serves all streams that carry the same clock,
    so that their stamps agree whatever the delay of each.

    Parameters:
        drift (s/s): how fast the two clocks can drift apart.
        restart (s): how far a stamp may be off, and how long the sender must be silent before it counts as restarted.
    """

    def __init__(self, drift: float = 100e-6, restart: float = 0.5) -> None:
        self.drift = drift
        self.restart = restart
        self.restarts = 0
        self._offset: float | None = None
        self._accepted = 0.0    # when a stamp was last accepted
        self._lags: deque[tuple[float, float]] = deque()    # arrival and lag over the last second

    @property
    def known(self) -> bool:
        """Whether anything has been observed yet."""
        return self._offset is not None

    def observe(self, stamp: float, arrival: float) -> bool:
        """Take one arrival (ROS time, s) of a datagram stamped by the sender (s); False where it is refused."""
        offset = arrival - stamp
        if self._offset is None:
            self._offset = offset
        elif abs(offset - self._offset) > self.restart:
            if arrival - self._accepted <= self.restart:
                return False
            self._offset = offset
            self.restarts += 1
        else:
            self._offset = min(self._offset + self.drift * max(arrival - self._accepted, 0.0), offset)
        self._accepted = max(self._accepted, arrival)
        self._lags.append((arrival, offset - self._offset))
        while self._lags[0][0] < arrival - 1.0:
            self._lags.popleft()
        return True

    @property
    def lateness(self) -> float:
        """Seconds by which even the quickest datagram of the last second was late: the sender does not keep up."""
        return min((lag for _, lag in tuple(self._lags)), default=0.0)

    def to_ros(self, stamp: float) -> float:
        """ROS time in s of a sender's stamp. Raises RuntimeError before the first observation."""
        if self._offset is None:
            raise RuntimeError('the sender has not been heard yet')
        return stamp + self._offset

    def date_late(self, stamp: float, arrival: float, latest: float) -> float | None:
        """As `date`, but a stamp that is too late to set the clock by is dated all the same, up to `latest` s."""
        if self.observe(stamp, arrival) or -self.restart < arrival - self.to_ros(stamp) < latest:
            return self.to_ros(stamp)
        return None


class SampleClock(CaptureClock):
    """Fits the time of samples to the times at which their blocks came in.

    A line through (sample, time) with exponential forgetting: its slope is the true sample rate, its scatter the
    jitter. `to_ros` follows that line with a bounded slew, so that stamps are evenly spaced.

    Parameters:
        sample_rate (Hz): the nominal rate, in which the stamps of this clock count samples.
    """

    def __init__(self, sample_rate: int) -> None:
        self.sample_rate = sample_rate
        self.restarts = 0
        # (sample, time, drift) of the newest blocks; replaced as a whole, as reader and capture are different threads
        self._anchors: tuple[tuple[float, float, float], ...] = ()
        self._late_blocks = 0
        self._first, self._base = 0.0, 0.0    # the sample and time at which the line began
        # weighted sums of 1, x, y, x x, x y: x in s before the newest sample, y the excess over nominal time
        self._sums = (1.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def ppm(self) -> float:
        """How much slower than nominal the device's clock runs against ours, in parts per million."""
        return 1e6 * self._anchors[-1][2] if self._anchors else 0.0

    def to_ros(self, stamp: float) -> float:
        """Capture time in s (ROS time) of sample number `stamp`. Raises RuntimeError before the first `observe`."""
        anchors = self._anchors
        if not anchors:
            raise RuntimeError('the sample clock has seen no block yet')
        first, time, drift = next((anchor for anchor in reversed(anchors) if anchor[0] <= stamp), anchors[0])
        return time + (stamp - first) / self.sample_rate * (1.0 + drift)

    def observe(self, stamp: float, arrival: float) -> bool:
        """Sample number `stamp` was captured at about `arrival` (ROS time, s); False where that is late and not used."""
        error = arrival - self.to_ros(stamp) if self._anchors else 0.0
        self._late_blocks = self._late_blocks + 1 if error > LATE_S else 0
        if not self._anchors or error < -LATE_S or self._late_blocks > LATE_BLOCKS:
            self._begin(stamp, arrival)
        elif not self._late_blocks:
            self._follow(stamp, arrival)
        return not self._late_blocks

    def _follow(self, sample: float, time: float) -> None:
        predicted = self.to_ros(sample)
        nominal = self._base + (sample - self._first) / self.sample_rate
        excess, slope = self._fit((sample - self._anchors[-1][0]) / self.sample_rate, time - nominal)
        correction = nominal + excess - predicted
        drift = max(-MOST_DRIFT, min(MOST_DRIFT, slope))
        anchor = (sample, predicted + max(-SLEW_S, min(SLEW_S, correction)), drift)
        self._anchors = (*self._anchors[1 - REMEMBERED_BLOCKS:], anchor)

    def _begin(self, sample: float, time: float) -> None:
        self.restarts += bool(self._anchors)
        self._late_blocks = 0
        self._anchors = ((sample, time, 0.0),)
        self._first, self._base = sample, time
        self._sums = (1.0, 0.0, 0.0, 0.0, 0.0)

    def _fit(self, elapsed: float, excess: float) -> tuple[float, float]:
        """Add a point and return the line's excess at it and its slope; the slope is 0 until it is more than jitter."""
        n, x, y, xx, xy = self._sums
        # move the origin of x to the newest point, then forget a little
        x, xx, xy = x - elapsed * n, xx - 2.0 * elapsed * x + elapsed**2 * n, xy - elapsed * y
        keep = 1.0 - min(0.5, max(0.0, elapsed) / MEMORY_S)
        n, x, y, xx, xy = (keep * value for value in (n, x, y, xx, xy))
        n, y = n + 1.0, y + excess
        self._sums = (n, x, y, xx, xy)
        variance = xx / n - (x / n) ** 2
        slope = (xy / n - x * y / n**2) / variance if variance > SLOPE_SPREAD_S**2 else 0.0
        return (y - slope * x) / n, slope


class SampleCounter:
    """Gives blocks of which only the stamps are known an index of their first sample, in which a gap shows."""

    def __init__(self) -> None:
        self._expected: tuple[int, float] | None = None  # sample index and stamp of the next block

    def place(self, count: int, sample_rate: int, stamp: float) -> int:
        """Index of the first of `count` samples captured at `stamp` (s); a stamp far before the expected is a gap, too."""
        first_sample, due = self._expected or (0, stamp)
        if abs(stamp - due) > GAP_S:
            first_sample += max(1, round((stamp - due) * sample_rate))
        self._expected = first_sample + count, stamp + count / sample_rate
        return first_sample
