"""Adaptive process noise: the present acceleration of the target relative to the motion model."""

from __future__ import annotations

import math
from typing import NamedTuple

EXPECTED_NIS, LARGEST_NIS = 1.0, 9.0  # normalised innovation squared: mean of a consistent filter, and bound
FALL = 1.0  # gain of the logarithm of the scale where innovations are small
LEAST = 0.03  # lower bound of the scale
LEAST_IN_VIEW = 0.1  # lower bound while the camera sees the target
OBSERVED = 0.34  # derivative of the measured cosine by the direction, 20 degrees from end-fire, from which a turn is observed
STEADY_COUNT = 7.0  # independent measurements of steady motion that halve the upper bound of 1
MANOEUVRE_SCALE = 2.0  # a scale above this is a manoeuvre, after which steadiness is counted from zero


class Adaptation(NamedTuple):
    """How the scale follows the innovations.

    Parameters:
        rise: gain of the logarithm of the scale where innovations are large.
        slow (rad/s): slower motion is not evidence of steadiness.
        largest: upper bound of the scale.
        least_heard: lower bound where the target is heard only, and not at end-fire.
    """

    rise: float
    slow: float
    largest: float
    least_heard: float


# With a smaller scale a target that turns back after long steady motion is lost: by sound the scale rises too late.
ONLY = Adaptation(rise=3.0, slow=math.radians(5.0), largest=10.0, least_heard=0.5)
# Several targets are told apart by steady motion, also by slow one, if a manoeuvre is noticed all the sooner.
ONE_OF_SEVERAL = Adaptation(rise=8.0, slow=math.radians(2.0), largest=33.0, least_heard=LEAST)


class AdaptiveProcessNoise:
    """Scale of the acceleration density, relative to the motion model.

    It rises after large innovations and falls after small ones, judged by the normalised innovation squared (Bar-Shalom, Li,
    Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 11.2.2), averaged over all components
    by weight. It is common to all components: with a separate scale, a false image with large innovations could soon follow
    any measurement, and would outlast the true one. Below 1 it falls with the duration of steady motion, since a target that
    has moved steadily for seconds rarely turns back just at end-fire, where the turn cannot be observed.

    Attributes:
        value: the scale.
        adaptation: how it follows the innovations.
    """

    def __init__(self) -> None:
        self.value, self.adaptation = 1.0, ONLY
        self._steady = self._nis = self._weight = self._moving = self._slope = 0.0
        self._observed = True

    def least(self, in_view: bool) -> float:
        """Lower bound of the scale of a prediction, by whether the camera sees the target."""
        return LEAST_IN_VIEW if in_view else self.adaptation.least_heard if self._observed else LEAST

    def note(self, weight: float, rate: float, innovation: float, variance: float, slope: float = 1.0) -> None:
        """Add the innovation of a component.

        Parameters:
            weight: weight of the component.
            rate (rad/s): rate of its azimuth.
            innovation, variance: innovation of a scalar measurement and its variance, in any unit.
            slope: derivative of what is measured by the direction, 0 at end-fire.
        """
        self._nis += weight * min(innovation * innovation / variance, LARGEST_NIS)
        self._weight += weight
        self._slope += weight * slope
        self._moving += weight * rate * rate / (rate * rate + self.adaptation.slow**2)

    def adapt(self, fraction: float) -> None:
        """Adapt the scale to the innovations noted since the last call, with the effective sample fraction `fraction`."""
        excess = self._nis - EXPECTED_NIS * self._weight
        value = self.value * math.exp((self.adaptation.rise if excess > 0.0 else FALL) * fraction * excess)
        self._steady = 0.0 if value > MANOEUVRE_SCALE else self._steady + fraction * self._moving
        self.value = min(max(value, LEAST, 1.0 / (1.0 + (self._steady / STEADY_COUNT) ** 2)), self.adaptation.largest)
        self._observed = self._slope > OBSERVED * self._weight if self._weight > 0.0 else self._observed
        self._nis = self._weight = self._moving = self._slope = 0.0
