"""Motion with nearly constant velocity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def nearly_constant_velocity(step: float, density: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transition (2, 2) and covariance (2, 2) of the process noise of (position, velocity) along one axis.

    The acceleration is white (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    section 6.2.2).

    Parameters:
        step (s): of time; noise grows with its amount, back in time, too.
        density: spectral density of the acceleration, in the square of the position's unit over s^3.
    """
    amount = abs(step)
    return (np.array([[1.0, step], [0.0, 1.0]]),
            density * np.array([[amount**3 / 3.0, amount**2 / 2.0], [amount**2 / 2.0, amount]]))
