"""Self-calibration of a linear microphone array by the camera: axis, baseline, delay, and curvature of the delays.

A linear array measures the cosine m of the angle between the direction of arrival and its axis. While the camera sees the
target, the true direction is known:

    m = b + (1 + s) cos(d + o) cos(e) + c2 P2(cos d cos e) + c3 P3(cos d cos e)

with d, e the target's azimuth from the nominal axis and its elevation, o the offset of the axis, s the relative error of the
baseline (or of the speed of sound), b the effect of a delay between the channels, and Legendre polynomials P2, P3 for a body
that bends the delays smoothly. These five parameters are learnt.
"""

from __future__ import annotations

import math
from operator import mul

import numpy as np

from av_common.microphone_array import COSINES
from av_common.quaternions import quaternion_of, rotation
from av_fusion.calibration.self_calibration import SelfCalibration
from av_fusion.measurement.measurements import Cone, DoaMeasurement
from av_fusion.measurement.vectors import turned

NAMES = ('axis offset', 'baseline scale', 'channel delay', 'curvature 2', 'curvature 3')
SIGMAS = np.array([math.radians(5.0), 0.05, 0.02, 0.02, 0.02])  # of their prior: rad, then relative to the cosine
UNITS = ((math.degrees(1.0), 'deg'), *(((100.0, '%'),) * 4))


class ArraySelfCalibration(SelfCalibration):
    """Estimate of the array's parameters: `compare` updates it, `corrected` applies it."""

    def __init__(self) -> None:
        super().__init__(NAMES, SIGMAS, UNITS)

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
        residual = measured - math.cos(azimuth) * math.cos(elevation)
        return self.learn(time, [slopes], [residual], [variance], [seen_variance * slopes[0] ** 2])

    def correct(self, measured: float, azimuth: float) -> tuple[float, float]:
        """Cosines that the nominal array would have measured for a level target and for its mirror image.

        Parameters:
            measured: measured cosine of the angle from the axis.
            azimuth (rad): approximate azimuth of the target from the nominal axis.
        """
        across, *along = sensitivities(azimuth, 0.0)
        offset, *others = self.values
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
        odds = measurement.odds
        if odds:
            odds = tuple(np.interp(COSINES + cone.cosine - moved.cosine, COSINES, odds).tolist())
        return measurement._replace(hypotheses=moved.images(), cone=moved, odds=odds)


def sensitivities(azimuth: float, elevation: float) -> tuple[float, float, float, float, float]:
    """Derivatives of the measured cosine with respect to the parameters.

    Parameters:
        azimuth, elevation (rad): direction; the azimuth is measured from the nominal axis.
    """
    level = math.cos(elevation)
    x = math.cos(azimuth) * level
    return -math.sin(azimuth) * level, x, 1.0, 1.5 * x * x - 0.5, (2.5 * x * x - 1.5) * x
