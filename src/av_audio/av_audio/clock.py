"""The time at which samples were captured."""

from __future__ import annotations

# Blocks arrive with a jitter of milliseconds; over this many seconds it averages out and drift still shows.
MEMORY_S = 60.0
# Stamps move towards the fit by at most this much per block, so that they are regular from the first one on.
SLEW_S = 2e-5
# Blocks that wait for their reader keep the time they had when they came.
REMEMBERED_BLOCKS = 64
# A busy machine delivers single blocks late by any time; so many in a row mean that the clock was set: begin anew. No
# block comes early: it was the first one that came late.
LATE_S = 0.05
LATE_BLOCKS = 100
MOST_DRIFT = 2e-3
# Streams without a sample index: a stamp further than this from where it was expected is a gap.
GAP_S = 0.02
# The slope counts once the times spread by this standard deviation, after about ten seconds.
SLOPE_SPREAD_S = 3.0


class SampleClock:
    """Fits the time of samples to the times at which blocks came in.

    A line through (sample, time) with exponential forgetting: its slope is the true sample rate, its scatter the
    jitter. `time_of` follows that line with a bounded slew.
    """

    def __init__(self, sample_rate: int) -> None:
        self.sample_rate = sample_rate
        self.restarts = -1  # how often the line had to begin anew
        # (sample, time, drift) of the newest blocks; replaced as a whole, as reader and capture are different threads
        self._anchors: tuple[tuple[int, float, float], ...] = ()
        self._late_blocks = 0

    @property
    def ppm(self) -> float:
        """How much slower than nominal the device's clock runs against ours, in parts per million."""
        return 1e6 * self._anchors[-1][2] if self._anchors else 0.0

    def time_of(self, sample: int) -> float:
        """Capture time in s of a sample. Raises ValueError before the first `observe`."""
        anchors = self._anchors
        if not anchors:
            raise ValueError('the sample clock has seen no block yet')
        first, time, drift = next((anchor for anchor in reversed(anchors) if anchor[0] <= sample), anchors[0])
        return time + (sample - first) / self.sample_rate * (1.0 + drift)

    def observe(self, sample: int, time: float) -> None:
        """A sample was seen to be captured at about this time in s."""
        error = time - self.time_of(sample) if self._anchors else 0.0
        self._late_blocks = self._late_blocks + 1 if error > LATE_S else 0
        if not self._anchors or error < -LATE_S or self._late_blocks > LATE_BLOCKS:
            self._begin(sample, time)
        elif not self._late_blocks:
            self._follow(sample, time)

    def _follow(self, sample: int, time: float) -> None:
        predicted = self.time_of(sample)
        nominal = self._base + (sample - self._first) / self.sample_rate
        excess, slope = self._fit((sample - self._anchors[-1][0]) / self.sample_rate, time - nominal)
        correction = nominal + excess - predicted
        drift = max(-MOST_DRIFT, min(MOST_DRIFT, slope))
        anchor = (sample, predicted + max(-SLEW_S, min(SLEW_S, correction)), drift)
        self._anchors = (*self._anchors[1 - REMEMBERED_BLOCKS:], anchor)

    def _begin(self, sample: int, time: float) -> None:
        self.restarts += 1
        self._late_blocks = 0
        self._anchors = ((sample, time, 0.0),)
        self._first, self._base = sample, time
        # weighted sums of 1, x, y, x x, x y: x in s before the newest sample, y the excess over nominal time
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
        """Index of the first of `count` samples that were captured at `stamp` in s. A stamp far behind is a gap, too."""
        first_sample, due = self._expected or (0, stamp)
        if abs(stamp - due) > GAP_S:
            first_sample += max(1, round((stamp - due) * sample_rate))
        self._expected = first_sample + count, stamp + count / sample_rate
        return first_sample
