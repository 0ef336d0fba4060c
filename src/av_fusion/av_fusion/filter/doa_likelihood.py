"""Likelihood of a direction of arrival under a component of the posterior, and its linearised measurement."""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import tau
from typing import NamedTuple, Protocol

from av_fusion.filter.gaussian_component import GaussianComponent
from av_fusion.measurement.measurements import Cone, Hypothesis


class Comparison(NamedTuple):
    """A scalar measurement compared with what a component predicts.

    Parameters:
        component: the component.
        row: measurement row, the derivatives with respect to azimuth, azimuth rate and elevation.
        variance: variance of the innovation.
        innovation: measured minus predicted value.
        fit: likelihood relative to that of a component that predicts the measured value without error and variance; at most 1.
    """

    component: GaussianComponent
    row: tuple[float, float, float]
    variance: float
    innovation: float
    fit: float


class DoaLikelihood(Protocol):
    """A direction of arrival to compare with components."""

    def compare(self, component: GaussianComponent, lag: float) -> Comparison:
        """Compare with the state of a component `lag` s before its time.

        Parameters:
            component: component of the posterior.
            lag (s): time of the component minus time of the measurement.
        """


class ConeLikelihood:
    """The cosine that a linear array measures, whichever of the two images is the source.

    Parameters:
        axis (rad): azimuth of the array's axis in the world.
        cosine: measured cosine of the angle from the axis.
        variance: variance of the cosine's error from all causes.
    """

    def __init__(self, axis: float, cosine: float, variance: float) -> None:
        self._axis, self._cosine, self._variance = axis, cosine, variance

    def compare(self, component: GaussianComponent, lag: float) -> Comparison:
        """See `DoaLikelihood`."""
        mean, variance, row = component.expected_cosine(self._axis, lag)
        innovation, total = self._cosine - mean, variance + self._variance
        return Comparison(component, row, total, innovation, _fit(innovation, total, self._variance))


class DirectionLikelihood:
    """Alternative directions; each component is compared with the nearest one.

    Parameters:
        azimuths (rad): azimuths in the world.
        variances (rad^2): variances of their errors.
    """

    def __init__(self, azimuths: Sequence[float], variances: Sequence[float]) -> None:
        self._azimuths, self._variances = azimuths, variances

    def compare(self, component: GaussianComponent, lag: float) -> Comparison:
        """See `DoaLikelihood`."""
        innovation, noise = min(((component.innovation(azimuth, lag), variance)
                                 for azimuth, variance in zip(self._azimuths, self._variances, strict=True)),
                                key=lambda pair: abs(pair[0]))
        total = component.expected_variance(lag) + noise
        return Comparison(component, (1.0, -lag, 0.0), total, innovation, _fit(innovation, total, noise))


def mirror_axis(hypotheses: Sequence[Hypothesis], cone: Cone | None) -> float | None:
    """Body azimuth (rad) of the axis about which the images of a measurement are mirrored.

    None for a single direction, and for images of one azimuth, such as those above and below a horizontal planar array.

    Parameters:
        hypotheses: directions in the body frame.
        cone: their cone; None for other arrays than linear ones.
    """
    if cone is not None:
        return cone.axis
    if len(hypotheses) != 2:
        return None
    first, second = hypotheses
    apart = math.remainder(second.azimuth - first.azimuth, tau)
    if apart**2 < 4.0 * max(first.azimuth_variance, second.azimuth_variance):
        return None
    return first.azimuth + 0.5 * apart


def _fit(innovation: float, total: float, noise: float) -> float:
    return math.exp(-0.5 * innovation * innovation / total) * math.sqrt(noise / total)
