"""How targets move, as seen from the rig, and how much of it the present target uses."""

from __future__ import annotations

import math
from typing import NamedTuple

CLIMB_S = 1.0  # time constant of changes of the vertical rate of targets close to the horizon


class MotionModel(NamedTuple):
    """Motion of targets as seen from the rig.

    Parameters:
        acceleration_density (rad^2/s^3): spectral density of the angular acceleration.
        elevation_density (rad^2/s): diffusion of the elevation of targets close to the horizon.
        usual_elevation (rad), usual_elevation_variance (rad^2): its stationary distribution.
        usual_inverse_range (1/m): mean and standard deviation of the inverse range.
    """

    acceleration_density: float
    elevation_density: float
    usual_elevation: float
    usual_elevation_variance: float
    usual_inverse_range: float = 0.03

    @property
    def climb_variance(self) -> float:
        """Variance (rad^2/s^2) of the vertical rate of targets close to the horizon: half of their diffusion."""
        return 0.25 * self.elevation_density / CLIMB_S


# Normalised innovation squared: mean of a consistent filter, and bound for one measurement.
EXPECTED_NIS, LARGEST_NIS = 1.0, 9.0
RISE, FALL = 6.0, 1.0  # gains of the logarithm of the scale for innovations that are larger, and smaller, than expected
LEAST, LARGEST = 0.03, 40.0  # bounds of the scale: steady flight, and a drone that turns back within a second at 20 m
SLOW = math.radians(2.0)  # rad/s; slower motion is not evidence of steadiness
STEADY_COUNT = 7.0  # independent measurements of steady motion that halve the upper bound of 1
MANOEUVRE = 2.0  # a scale above this is a manoeuvre, after which steadiness is counted from zero


class AdaptiveProcessNoise:
    """Scale of the acceleration density, relative to the motion model.

    It rises after large innovations and falls after small ones, judged by the normalised innovation squared (Bar-Shalom, Li,
    Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 11.2.2), averaged over all components
    by weight. It is common to all components: with a separate scale, a mirror image with large innovations could soon follow
    any measurement, and would outlast the true one.

    Attributes:
        value: the scale.
    """

    def __init__(self) -> None:
        self.value = 1.0
        self._steady = self._nis = self._weight = self._moving = 0.0

    def note(self, weight: float, rate: float, innovation: float, variance: float) -> None:
        """Add the innovation of a component.

        Parameters:
            weight: probability of the component, and that the measurement is its own.
            rate (rad/s): rate of its direction.
            innovation, variance: innovation of a scalar measurement and its variance, in any unit.
        """
        self._nis += weight * min(innovation * innovation / variance, LARGEST_NIS)
        self._weight += weight
        self._moving += weight * rate * rate / (rate * rate + SLOW**2)

    def adapt(self, fraction: float) -> None:
        """Adapt the scale to the innovations noted since the last call, with the effective sample fraction `fraction`."""
        excess = self._nis - EXPECTED_NIS * self._weight
        value = self.value * math.exp((RISE if excess > 0.0 else FALL) * fraction * excess)
        self._steady = 0.0 if value > MANOEUVRE else self._steady + fraction * self._moving
        self.value = min(max(value, LEAST, 1.0 / (1.0 + (self._steady / STEADY_COUNT) ** 2)), LARGEST)
        self._nis = self._weight = self._moving = 0.0
