"""How targets move, as seen from the rig: an interacting multiple model of steady flight and manoeuvres."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

CLIMB_S = 1.0  # time constant of changes of the vertical rate of targets close to the horizon


class Elevation(NamedTuple):
    """A Gaussian of the prior of elevations.

    Parameters:
        mean (rad), variance (rad^2): of the elevation.
        share: its weight.
    """

    mean: float
    variance: float
    share: float


@dataclass(frozen=True)
class MotionModel:
    """Motion of targets as seen from the rig, a jump Markov linear system.

    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 11.6.6.

    Parameters:
        elevation_density (rad^2/s): diffusion of the elevation of targets close to the horizon.
        elevations: prior of the elevation, a sum of Gaussians, the commonest first, to which it returns. The share of high
            targets bounds what a camera tells that shows nothing ahead: the target may be above its view.
        accelerations (k,) (rad^2/s^3): spectral density of the angular acceleration by mode: steady flight, 0.4 m/s^2 for a
            second at 20 m, manoeuvres, 4 m/s^2, and the same at a quarter of the distance.
        shares (k,): stationary probabilities of the modes.
        sojourn (s): mean time after which the mode is drawn anew.
        usual_inverse_range (1/m): mean and standard deviation of the inverse range.
        climb_rates (k,) (rad/s): standard deviation of the vertical rate of targets close to the horizon, by mode: in steady
            flight it makes half of the elevation's diffusion, in manoeuvres it is the median of 76 real clips, and fourfold
            at a quarter of the distance.
    """

    elevation_density: float = 0.001
    elevations: tuple[Elevation, ...] = (Elevation(math.radians(9.0), math.radians(8.0) ** 2, 0.98),
                                         Elevation(math.radians(38.0), math.radians(13.0) ** 2, 0.02))
    accelerations: NDArray[np.float64] = field(default_factory=lambda: np.array([0.001, 0.1, 1.6]), repr=False)
    shares: NDArray[np.float64] = field(default_factory=lambda: np.array([0.8, 0.195, 0.005]), repr=False)
    sojourn: float = 1.0
    usual_inverse_range: float = 0.03
    climb_rates: NDArray[np.float64] = field(default_factory=lambda: np.radians([0.9, 4.4, 17.6]), repr=False)

    def prior_of(self, elevation: float, variance: float) -> float:
        """Prior density (1/rad) of an elevation (rad) that was measured with a variance (rad^2), but for a common factor."""
        totals = [usual.variance + variance for usual in self.elevations]
        return sum(usual.share * math.exp(max(-0.5 * (elevation - usual.mean) ** 2 / total, -300.0)) / math.sqrt(total)
                   for usual, total in zip(self.elevations, totals, strict=True))

    def transitions(self, dt: float) -> NDArray[np.float64]:
        """Probabilities (k, k) of each mode (columns) `dt` s after another one (rows)."""
        kept = math.exp(-dt / self.sojourn)
        probabilities = np.array([(1.0 - kept) * self.shares] * len(self.shares))
        probabilities.flat[::len(self.shares) + 1] += kept
        return probabilities
