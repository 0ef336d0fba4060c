"""Self-calibration of a linear microphone array by the camera: axis, baseline, delay, and curvature of the delays.

A linear array measures the cosine m of the angle between the direction of arrival and its axis. While the camera sees the
target, the true direction is known:

    m = b + (1 + s) cos(d + o) cos(e) + c2 P2(cos d cos e) + c3 P3(cos d cos e)

with d, e the target's azimuth from the nominal axis and its elevation, o the offset of the axis, s the relative error of the
baseline (or of the speed of sound), b the effect of a delay between the channels, and Legendre polynomials P2, P3 for a body
that bends the delays smoothly. Recursive least squares with exponential forgetting (Ljung, System Identification, 1999,
eq. 11.12) estimates the five parameters. The prior is the array as described; forgetting returns to this prior
(stabilised forgetting, Kulhavy and Zarrop 1993), so that parameters that are not excited keep their prior value.
"""

from __future__ import annotations

import math
from operator import mul

import numpy as np
from numpy.typing import NDArray

from av_common.quaternions import quaternion_of, rotation
from av_fusion.measurement.measurements import Cone, DoaMeasurement
from av_fusion.measurement.vectors import turned

SIGHT_CORRELATION_S = 5.0  # errors of the camera's calibration persist; comparisons within this time are not independent
LEAST_CONFIDENCE = 0.5  # of detections and of directions of arrival that are compared
NAMES = ('axis offset', 'baseline scale', 'channel delay', 'curvature 2', 'curvature 3')
SIGMAS = np.array([math.radians(5.0), 0.05, 0.02, 0.02, 0.02])  # of their prior: rad, then relative to the cosine
BOUNDS = 2.0 * SIGMAS  # largest corrections
GATE = 4.0  # largest innovation of a comparison that is used, in standard deviations
MEMORY_S = 60.0  # time constant of forgetting


class ArraySelfCalibration:
    """Recursive estimate of the array's parameters: `compare` updates it, `corrected` applies it.

    Parameters:
        memory (s): time constant of forgetting.

    Attributes:
        compared: number of comparisons used so far.
    """

    def __init__(self, memory: float = MEMORY_S) -> None:
        self._memory = memory
        self._prior = np.diag(1.0 / SIGMAS**2)  # information matrix
        self._gained = np.zeros_like(self._prior)  # information beyond the prior
        self._covariance = np.linalg.inv(self._prior)
        self._vector = np.zeros(len(NAMES))
        self._time = -math.inf
        self._values = [0.0] * len(NAMES)
        self.compared = 0

    @property
    def values(self) -> NDArray[np.float64]:
        """The parameters (5,), in the order of NAMES."""
        return np.array(self._values)

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """Standard deviations of the parameters (5,)."""
        return np.sqrt(np.diag(self._covariance))

    @property
    def at_limit(self) -> list[str]:
        """Names of the parameters that are learnt, and would be corrected by more than is permitted."""
        learnt = self.sigmas < 0.5 * SIGMAS
        return [name for name, stands in zip(NAMES, learnt & (np.abs(self.values) >= BOUNDS), strict=True) if stands]

    def compare(self, time: float, measured: float, azimuth: float, elevation: float, variance: float,
                seen_variance: float = 0.0) -> bool:
        """Update the parameters by a measured cosine and the direction in which the camera saw the target at that time.

        Parameters:
            time (s): capture time of both.
            measured: cosine of the angle from the axis.
            azimuth, elevation (rad): the target's direction; azimuth is from the nominal axis.
            variance: variance of the cosine's error; to be enlarged when the errors of successive calls are correlated.
            seen_variance (rad^2): variance of the azimuth, whose error persists for SIGHT_CORRELATION_S.

        Returns whether the comparison was used.
        """
        if not (math.isfinite(measured) and 0.0 < variance < math.inf):
            return False
        slopes = sensitivities(azimuth, elevation)
        row = np.array(slopes)
        residual = measured - math.cos(azimuth) * math.cos(elevation)
        seconds = min(max(time - self._time, 0.01), SIGHT_CORRELATION_S)
        variance += seen_variance * slopes[0] ** 2 * SIGHT_CORRELATION_S / seconds
        spread = float(row.dot(self._covariance).dot(row)) + variance
        if (residual - sum(map(mul, slopes, self._values))) ** 2 > GATE**2 * spread:
            return False
        kept = math.exp(-min(max(time - self._time, 0.0), 1.0) / self._memory)
        self._time = max(self._time, time)
        weighed = row / variance
        self._gained = kept * self._gained + row[:, None] * weighed
        self._vector = kept * self._vector + residual * weighed
        self._covariance = np.linalg.inv(self._prior + self._gained)
        values = self._covariance.dot(self._vector)
        self._values = np.minimum(np.maximum(values, -BOUNDS), BOUNDS).tolist()
        self.compared += 1
        return True

    def correct(self, measured: float, azimuth: float) -> tuple[float, float]:
        """Cosines that the nominal array would have measured for a level target and for its mirror image.

        Parameters:
            measured: measured cosine of the angle from the axis.
            azimuth (rad): approximate azimuth of the target from the nominal axis.
        """
        across, *along = sensitivities(azimuth, 0.0)
        offset, *others = self._values
        turned, common = across * offset, measured - sum(map(mul, along, others))
        return min(max(common - turned, -1.0), 1.0), min(max(common + turned, -1.0), 1.0)

    def corrected(self, measurement: DoaMeasurement) -> DoaMeasurement:
        """The measurement that a nominal array would have made; a measurement without a cone is returned unchanged."""
        cone = measurement.cone
        if cone is None or not self.compared:
            return measurement
        left, right = map(math.acos, self.correct(cone.cosine, cone.angle))
        axis = turned(rotation(quaternion_of((0.0, 0.0, 0.5 * (left - right)))), cone.axis)
        moved = Cone(axis, math.cos(0.5 * (left + right)), cone.variance)
        return measurement._replace(hypotheses=moved.images(), cone=moved)

    def describe(self) -> dict[str, str]:
        """The parameters with their standard deviations, as texts for diagnostics."""
        units = ((math.degrees(1.0), 'deg'), *(((100.0, '%'),) * 4))
        return {name: f'{scale * value:+.2f} +- {scale * sigma:.2f} {unit}'
                for name, value, sigma, (scale, unit) in zip(NAMES, self.values, self.sigmas, units, strict=True)}


def sensitivities(azimuth: float, elevation: float) -> tuple[float, float, float, float, float]:
    """Derivatives of the measured cosine with respect to the parameters.

    Parameters:
        azimuth, elevation (rad): direction; the azimuth is measured from the nominal axis.
    """
    level = math.cos(elevation)
    x = math.cos(azimuth) * level
    return -math.sin(azimuth) * level, x, 1.0, 1.5 * x * x - 0.5, (2.5 * x * x - 1.5) * x
