"""Motion with nearly constant, or with slowly forgotten, velocity."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from av_network.settings import NetworkSettings


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


def forgotten_velocity(step: float, density: float, memory: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The same for a velocity that returns to zero: an integrated Ornstein-Uhlenbeck process.

    Its uncertainty stays finite while nothing is measured: the variance of the velocity tends to density * memory / 2. A
    stationary process is the same back in time (Uhlenbeck and Ornstein, On the theory of the Brownian motion, Physical Review
    36, 1930).

    Parameters:
        step (s): of time, of any sign.
        density: see `nearly_constant_velocity`.
        memory (s): time in which the velocity falls to 1 / e of itself.
    """
    amount = abs(step) / memory
    if amount < 1e-3:  # differences of nearly equal numbers; the relative error of the series is of this order
        F, Q = nearly_constant_velocity(step, density)
        return F * np.array([[1.0, 1.0 - 0.5 * amount], [1.0, 1.0 - amount]]), Q
    lost, lost_twice = -math.expm1(-amount), -math.expm1(-2.0 * amount)
    F = np.array([[1.0, math.copysign(memory * lost, step)], [0.0, 1.0 - lost]])
    cross = 0.5 * memory**2 * lost**2
    return F, density * np.array([[memory**3 * (amount - 2.0 * lost + 0.5 * lost_twice), cross],
                                  [cross, 0.5 * memory * lost_twice]])


def axes_shares(settings: NetworkSettings) -> NDArray[np.float64]:
    """Variances (3,) of velocity and acceleration along east, north and up over those of the horizontal axes."""
    return np.array([1.0, 1.0, settings.climb_share**2])


def target_motion(step: float, settings: NetworkSettings) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transition (6, 6) and covariance (6, 6) of the process noise of a target's position and velocity (ENU).

    Parameters:
        step (s): of time, of any sign.
        settings: `manoeuvre`, `climb_share` and `velocity_memory`.
    """
    F, Q = forgotten_velocity(step, settings.manoeuvre, settings.velocity_memory)
    return (np.asarray(np.kron(F, np.eye(3)), np.float64),
            np.asarray(np.kron(Q, np.diag(axes_shares(settings))), np.float64))


def velocity_covariance(settings: NetworkSettings) -> NDArray[np.float64]:
    """Prior covariance (3, 3) of a target's velocity (m^2/s^2), ENU."""
    return settings.speed_sigma**2 * np.diag(axes_shares(settings))
