"""Times of numbered samples, by the arrivals of their blocks."""

from __future__ import annotations

import math
from collections import deque

# Time constant of the fit: long enough to average a jitter of milliseconds, short enough to follow drift.
MEMORY_S = 60.0
# Slew (s/s) of sample stamps towards the fit, so that they are regular from the first block on, and for deviations of more
# than FAR_S.
SLEW = 2e-3
FAR_S = 0.003
FAST_SLEW = 0.02
# Number of blocks whose times are kept, for blocks that the reader has not fetched yet.
REMEMBERED_BLOCKS = 64
# Blocks that deviate by more are not used. They restart the fit when they agree with each other for AGREEMENT_S, because
# then the clock of the arrivals was set, or the first block was late.
OUTLIER_S = 0.05
AGREEMENT_S = 1.0
LATEST_S = 1.0    # a block that deviates by more was not delayed: the clock of the arrivals was set
FEWEST = 4
MOST_DRIFT = 0.03
# The slope is used once the times have this standard deviation, after about ten seconds, or when it is more than jitter.
SLOPE_SPREAD_S = 3.0
SLOPE_EXCESS_S = 0.005
SLOPE_BLOCKS = 15
LARGEST_SAMPLE = 2.0**53
END_OF_TIME_S = 2.0**31    # builtin_interfaces/Time holds 0 to this


class SampleClock:
    """Fits the times of samples to the times of arrival of their blocks.

    The model is a line through (sample, time) with exponential forgetting: its slope is the true sample rate, its scatter
    the jitter. `time_of` is continuous and follows that line with a bounded slew, however far apart blocks arrive.

    Parameters:
        sample_rate (Hz): nominal sample rate.

    Attributes:
        refused: number of blocks whose arrivals were not used.
        restarts: number of times that the fit was restarted.
    """

    def __init__(self, sample_rate: int) -> None:
        self.sample_rate = sample_rate
        self.refused = self.restarts = 0
        # (sample, time, drift, correction, its slew) of the newest blocks; replaced as a whole, as reader and capture are
        # different threads
        self._anchors: tuple[tuple[float, float, float, float, float], ...] = ()
        self._outliers: deque[tuple[float, float]] = deque(maxlen=1024)    # sample and error of blocks in succession
        self._first, self._base = 0.0, 0.0    # the sample and time at which the line began
        # weighted sums of 1, x, y, x x, x y: x in s before the newest sample, y the excess over nominal time
        self._sums = (1.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def doubtful(self) -> bool:
        """Whether the newest block deviates by more than lateness explains, so that its time is unknown."""
        return bool(self._outliers) and abs(self._outliers[-1][1]) > LATEST_S

    @property
    def ppm(self) -> float:
        """Amount in parts per million by which the device's clock is slower than nominal, relative to ROS time."""
        return 1e6 * self._anchors[-1][2] if self._anchors else 0.0

    def time_of(self, sample: float) -> float:
        """Capture time in s (ROS time) of a sample. Raises RuntimeError before the first `observe`."""
        anchors = self._anchors
        if not anchors:
            raise RuntimeError('the sample clock has no block yet')
        first, time, drift, correction, slew = next((anchor for anchor in reversed(anchors) if anchor[0] <= sample), anchors[0])
        elapsed = (sample - first) / self.sample_rate
        most = slew * max(elapsed, 0.0)
        return time + elapsed * (1.0 + drift) + max(-most, min(most, correction))

    def observe(self, sample: float, arrival: float) -> None:
        """Use the arrival of a block. Arrivals that contradict the others are counted in `refused`.

        Parameters:
            sample: number of the sample that arrived last, or of the first one with its estimated time of capture.
            arrival (s): its time, ROS time.
        """
        if not (0.0 <= sample <= LARGEST_SAMPLE and 0.0 <= arrival < END_OF_TIME_S):
            self.refused += 1
        elif not self._anchors:
            self._begin(sample, arrival)
        elif abs(error := arrival - self.time_of(sample)) <= OUTLIER_S and sample >= self._anchors[-1][0]:
            self._outliers.clear()
            self._follow(sample, arrival)
        elif error < 0.0 and 0.0 <= sample - self._first < AGREEMENT_S * self.sample_rate:
            self._begin(sample, arrival)    # the first blocks were late
        else:
            self.refused += 1
            self._doubt(sample, arrival, error)

    def _doubt(self, sample: float, arrival: float, error: float) -> None:
        """Keep an outlier; restart when those in succession agree."""
        if self._outliers and not (abs(error - self._outliers[0][1]) <= OUTLIER_S and sample >= self._outliers[-1][0]):
            self._outliers.clear()
        self._outliers.append((sample, error))
        span = (sample - self._outliers[0][0]) / self.sample_rate
        if len(self._outliers) >= FEWEST and span >= AGREEMENT_S:
            self.restarts += 1
            self._begin(sample, arrival - error + min(other for _, other in self._outliers))

    def _follow(self, sample: float, time: float) -> None:
        predicted = self.time_of(sample)
        elapsed = (sample - self._anchors[-1][0]) / self.sample_rate
        nominal = self._base + (sample - self._first) / self.sample_rate
        excess, slope = self._fit(elapsed, time - nominal)
        correction = nominal + excess - predicted
        slew = FAST_SLEW if abs(correction) > FAR_S else SLEW
        anchor = (sample, predicted, max(-MOST_DRIFT, min(MOST_DRIFT, slope)), correction, slew)
        self._anchors = (*self._anchors[1 - REMEMBERED_BLOCKS:], anchor)

    def _begin(self, sample: float, time: float) -> None:
        self._outliers.clear()
        self._anchors = ((sample, time, 0.0, 0.0, SLEW),)
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
        spread = math.sqrt(max(xx / n - (x / n) ** 2, 0.0))
        slope = (xy / n - x * y / n**2) / spread**2 if spread > 0.0 else 0.0
        if spread <= SLOPE_SPREAD_S and not (n > SLOPE_BLOCKS and abs(slope) * spread > SLOPE_EXCESS_S):
            slope = 0.0
        return (y - slope * x) / n, slope
