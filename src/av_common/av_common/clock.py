"""Clocks that convert the stamps or sample counts of senders and devices to ROS time in s.

A `SenderClock` dates stamped data, such as datagrams of a simulator, messages of PX4 and frames of a camera. Arrivals can
be late but never early, so the least delay gives the offset between the clocks. A `SampleClock` dates the blocks of a
microphone array, which need evenly spaced stamps and the true sample rate: it fits a line to their arrivals. A
`SampleCounter` gives indices to blocks that have only stamps.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque

# Time constant of the fit: long enough to average a jitter of milliseconds, short enough to follow drift.
MEMORY_S = 60.0
# Sample stamps move towards the fit by at most this much per block, so that they are regular from the first one on.
SLEW_S = 2e-5
# Number of blocks whose times are kept, for blocks that the reader has not fetched yet.
REMEMBERED_BLOCKS = 64
# A busy machine may deliver single blocks late. LATE_BLOCKS late blocks in succession mean that the clock was set, and the
# fit restarts. Blocks are never early: an early one means that the first block was late.
LATE_S = 0.05
LATE_BLOCKS = 100
MOST_DRIFT = 2e-3
# The slope is used once the times have this standard deviation, after about ten seconds.
SLOPE_SPREAD_S = 3.0
# Streams without a sample index: a stamp further than this from where it was expected is a gap.
GAP_S = 0.02


class CaptureClock(ABC):
    """Maps the time axis of a sender or device to ROS time.

    Attributes:
        restarts: number of times that the mapping was restarted.
    """

    restarts: int = 0

    @abstractmethod
    def observe(self, stamp: float, arrival: float) -> bool:
        """Update the mapping by one arrival; returns False when the stamp is refused.

        Parameters:
            stamp: time or count on the sender's axis.
            arrival (s): ROS time of its arrival.
        """

    @abstractmethod
    def to_ros(self, stamp: float) -> float:
        """ROS time in s of a stamp that was not refused. Raises RuntimeError before the first observation."""

    def date(self, stamp: float, arrival: float) -> float | None:
        """ROS time in s of a stamp, None when it is refused; parameters as for `observe`."""
        return self.to_ros(stamp) if self.observe(stamp, arrival) else None


class SenderClock(CaptureClock):
    """Offset between a sender's clock and ROS time, as the smallest difference of arrival and stamp (Cristian 1989).

    The offset may rise by `drift` seconds per second. A stamp that deviates by more than `restart` seconds is refused. When
    no other stamps arrive for that long, the sender was restarted or paused, and the clock restarts. One object serves all
    streams with stamps of the same clock, so that their times agree in spite of different delays.

    Parameters:
        drift (s/s): largest drift between the two clocks.
        restart (s): largest deviation of a stamp, and duration of silence after which the sender counts as restarted.
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
        """See `CaptureClock`; stamps are in s of the sender's clock."""
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
        """Least delay in s of the last second relative to the offset; it rises when the sender is too slow."""
        return min((lag for _, lag in tuple(self._lags)), default=0.0)

    def to_ros(self, stamp: float) -> float:
        """ROS time in s of a sender's stamp. Raises RuntimeError before the first observation."""
        if self._offset is None:
            raise RuntimeError('no stamp of the sender has arrived yet')
        return stamp + self._offset

    def date_late(self, stamp: float, arrival: float, latest: float) -> float | None:
        """As `date`, but also dates stamps that are too late to update the clock.

        Parameters:
            stamp (s): time on the sender's clock.
            arrival (s): ROS time of its arrival.
            latest (s): largest delay of a late stamp.
        """
        if self.observe(stamp, arrival) or -self.restart < arrival - self.to_ros(stamp) < latest:
            return self.to_ros(stamp)
        return None


class SampleClock(CaptureClock):
    """Fits the times of samples to the times of arrival of their blocks.

    The model is a line through (sample, time) with exponential forgetting: its slope is the true sample rate, its scatter
    the jitter. `to_ros` follows that line with a bounded slew, so that stamps are evenly spaced.

    Parameters:
        sample_rate (Hz): nominal sample rate; the stamps of this clock are sample numbers.
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
        """Amount in parts per million by which the device's clock is slower than nominal, relative to ROS time."""
        return 1e6 * self._anchors[-1][2] if self._anchors else 0.0

    def to_ros(self, stamp: float) -> float:
        """Capture time in s (ROS time) of sample number `stamp`. Raises RuntimeError before the first `observe`."""
        anchors = self._anchors
        if not anchors:
            raise RuntimeError('the sample clock has no block yet')
        first, time, drift = next((anchor for anchor in reversed(anchors) if anchor[0] <= stamp), anchors[0])
        return time + (stamp - first) / self.sample_rate * (1.0 + drift)

    def observe(self, stamp: float, arrival: float) -> bool:
        """Use the arrival (ROS time, s) of the sample number `stamp`; returns False for a late block, which is not used."""
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
    """Computes sample indices of blocks that have only stamps, with jumps where samples are missing."""

    def __init__(self) -> None:
        self._expected: tuple[int, float] | None = None  # sample index and stamp of the next block

    def place(self, count: int, sample_rate: int, stamp: float) -> int:
        """Index of the first sample of a block. A stamp far from the expected one, before or after, is a gap.

        Parameters:
            count: number of samples of the block.
            sample_rate (Hz): sample rate of the stream.
            stamp (s): capture time of the first sample.
        """
        first_sample, due = self._expected or (0, stamp)
        if abs(stamp - due) > GAP_S:
            first_sample += max(1, round((stamp - due) * sample_rate))
        self._expected = first_sample + count, stamp + count / sample_rate
        return first_sample
