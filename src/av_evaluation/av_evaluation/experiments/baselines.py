"""Baselines of the publication's comparison: a Kalman filter with fixed noise, and a moving average of what is heard."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from av_common.angles import wrap
from av_common.track import Source
from av_fusion.plain_tracker import PlainTracker

DENSITY = 0.02  # rad^2/s^3, of the white angular acceleration; one choice for all experiments, as the published filter's
NOISE = {Source.SOUND: math.radians(4.0) ** 2, Source.SIGHT: math.radians(1.0) ** 2}  # rad^2, whatever the measurement says
AVERAGED = 5  # windows, half a second


class KalmanTracker(PlainTracker):
    """Azimuth and its rate by measurements that count at their arrival, without compensation of delays."""

    def restart(self) -> None:
        """Forget the target."""
        self._time, self._state, self._covariance = -math.inf, np.zeros(2), 0.1 * np.eye(2)
        self._arrived: list[tuple[float, Source]] = []

    def update(self, time: float, azimuth: float, variance: float, source: Source) -> None:
        """See `PlainTracker`; the measurement waits for the next prediction, at whose time it counts."""
        self._arrived.append((azimuth, source))

    def predict(self, time: float) -> tuple[float, float] | None:
        """See `PlainTracker`."""
        if not self._arrived and self._time == -math.inf:
            return None
        if self._time == -math.inf:
            self._state[0] = self._arrived[0][0]
        dt = max(time - self._time, 0.0) if math.isfinite(self._time) else 0.0
        step = np.array([[1.0, dt], [0.0, 1.0]])
        noise = DENSITY * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
        state, covariance = step @ self._state, step @ self._covariance @ step.T + noise
        for azimuth, source in self._arrived:
            gain = covariance[:, 0] / (covariance[0, 0] + NOISE[source])
            state = state + gain * wrap(azimuth - state[0])
            covariance = covariance - np.outer(gain, covariance[0])
        if self._arrived:
            self._time, self._state, self._covariance, self._arrived = max(time, self._time), state, covariance, []
        return float(wrap(state[0])), float(covariance[0, 0])


class MovingAverage(PlainTracker):
    """Circular mean of the newest directions that are heard; what is seen is not used."""

    def restart(self) -> None:
        """Forget the target."""
        self._newest_heard: deque[tuple[complex, float]] = deque(maxlen=AVERAGED)

    def update(self, time: float, azimuth: float, variance: float, source: Source) -> None:
        """See `PlainTracker`."""
        if source == Source.SOUND:
            self._newest_heard.append((complex(math.cos(azimuth), math.sin(azimuth)), variance))

    def predict(self, time: float) -> tuple[float, float] | None:
        """See `PlainTracker`."""
        if not self._newest_heard:
            return None
        total = sum(one for one, _ in self._newest_heard)
        return math.atan2(total.imag, total.real), max(variance for _, variance in self._newest_heard)
