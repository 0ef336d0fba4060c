"""Motion of targets: modes of flight with accelerations of some duration, and velocities that are slowly forgotten."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Mode(NamedTuple):
    """Accelerations of a way to fly.

    Parameters:
        sigma (m/s^2): standard deviation along each horizontal axis.
        time (s): in which an acceleration falls to 1 / e of itself.
        duration (s): mean, of flying so.
    """

    sigma: float
    time: float
    duration: float


# Fitted to simulated smooth flights of up to 10 m/s and 3 m/s^2, as `ros2 run av_evaluation network bound` has them.
STEADY = Mode(0.8, 1.5, 8.0)
# Multirotors accelerate by up to A = 6 m/s^2, and turn back within a second. By Singer (1970) the variance of an acceleration
# that is uniform up to A, but +-A with probabilities of 0.1 each and none with 0.2, is A^2 / 3 (1 + 4 * 0.1 - 0.2).
MANOEUVRE = Mode(3.8, 0.6, 1.5)
MODES = (STEADY, MANOEUVRE)
SPEED_SIGMA = 8.0  # m/s, prior standard deviation of a target's velocity along each horizontal axis
CLIMB_SHARE = 0.3  # standard deviations of vertical velocities and accelerations over those of horizontal ones
VELOCITY_MEMORY_S = 8.0  # in which a small velocity falls to 1 / e of itself, unless it is measured anew
MEMORY_SPEED = 10.0  # m/s, from which on that time grows, with the square of the speed
LONGEST_STEP_S = 0.5  # short beside the memory of velocities
SHORT = 0.01  # of a step over the duration of accelerations


def nearly_constant_velocity(steps: NDArray[np.float64], density: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transitions (k, 2, 2) and covariances (k, 2, 2) of the process noise of (position, velocity) along one axis.

    The acceleration is white (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    section 6.2.2).

    Parameters:
        steps (k,) (s): of time.
        density: spectral density of the acceleration, in the square of the position's unit over s^3.
    """
    one = np.ones_like(steps)
    F = np.array([[one, steps], [0.0 * one, one]])
    Q = density * np.array([[steps**3 / 3.0, steps**2 / 2.0], [steps**2 / 2.0, steps]])
    return np.moveaxis(F, -1, 0), np.moveaxis(Q, -1, 0)


def singer(steps: NDArray[np.float64], variance: float, duration: float
           ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transitions (k, 3, 3) and covariances (k, 3, 3) of the noise of (position, velocity, acceleration) along one axis.

    The acceleration is exponentially correlated (Singer, Estimating optimal tracking filter performance for manned maneuvering
    targets, IEEE Trans. AES 6(4), 1970).

    Parameters:
        steps (k,) (s): of time; back in time, the velocity changes its sign.
        variance ((m/s^2)^2): of the acceleration.
        duration (s): time in which the acceleration falls to 1 / e of itself.
    """
    t, x = np.abs(steps), np.abs(steps) / duration
    once, twice, one = np.exp(-x), np.exp(-2.0 * x), np.ones_like(x)
    F = np.array([[one, t, duration**2 * (x - 1.0 + once)], [0.0 * x, one, duration * (1.0 - once)], [0.0 * x, 0.0 * x, once]])
    places, cross, speeds = (1.0 - twice + 2.0 * x + 2.0 / 3.0 * x**3 - 2.0 * x**2 - 4.0 * x * once,
                             1.0 + twice - 2.0 * once + 2.0 * x * once - 2.0 * x + x**2, 4.0 * once - 3.0 - twice + 2.0 * x)
    reach, change, rest = 1.0 - twice - 2.0 * x * once, (1.0 - once)**2, 1.0 - twice
    Q = np.array([[places, cross, reach], [cross, speeds, change], [reach, change, rest]])
    # Of short steps, these are differences of nearly equal numbers.
    short = np.array([[x**5 / 10.0, x**4 / 4.0, x**3 / 3.0], [x**4 / 4.0, 2.0 / 3.0 * x**3, x**2], [x**3 / 3.0, x**2, 2.0 * x]])
    units = np.array([duration**2, duration, 1.0])
    signs = np.stack([one, np.copysign(one, steps), one])
    turned = signs[:, None] * signs
    Q = variance * np.multiply.outer(units, units)[..., None] * np.where(x < SHORT, short, Q)
    return np.moveaxis(F * turned, -1, 0), np.moveaxis(Q * turned, -1, 0)


def axis_motion(steps: NDArray[np.float64], speeds: NDArray[np.float64], mode: Mode
                ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transitions (k, 3, 3) and covariances (k, 3, 3) of the process noise of k targets along one horizontal axis.

    Singer's model with a velocity that is forgotten, so that its uncertainty stays finite while nothing is measured. Slow
    drones stay where they are, fast ones fly on: the memory grows with the square of the speed.

    Parameters:
        steps (k,) (s): of time, of any sign.
        speeds (k,) (m/s): of the targets.
        mode: of flight.
    """
    parts = max(math.ceil(float(np.max(np.abs(steps), initial=0.0)) / LONGEST_STEP_S), 1)
    F, Q = singer(steps / parts, mode.sigma**2, mode.time)
    memory = VELOCITY_MEMORY_S * (1.0 + (speeds / MEMORY_SPEED) ** 2)
    half = np.stack([np.ones_like(memory), np.exp(-0.5 * np.abs(steps) / parts / memory), np.ones_like(memory)], 1)
    first, noise = half[:, :, None] * F * half[:, None], half[:, :, None] * Q * half[:, None]
    F, Q = first, noise
    for _ in range(parts - 1):
        F, Q = first @ F, first @ Q @ first.transpose(0, 2, 1) + noise
    return F, Q


def axes_shares() -> NDArray[np.float64]:
    """Variances (3,) of velocity and acceleration along east, north and up over those of the horizontal axes."""
    return np.array([1.0, 1.0, CLIMB_SHARE**2])


def target_motion(step: float, velocities: NDArray[np.float64]
                  ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transitions (n, m, 9, 9) and covariances (n, m, 9, 9) of the noise of targets' position, velocity and acceleration (ENU).

    Parameters:
        step (s): of time, of any sign.
        velocities (n, m, 3) (m/s): of the targets in each mode.
    """
    speeds, shares = np.linalg.norm(velocities, axis=2), np.diag(axes_shares())
    found = [axis_motion(np.full(len(speeds), step), speeds[:, k], mode) for k, mode in enumerate(MODES)]
    F, Q = (np.stack(part, 1) for part in zip(*found, strict=True))
    return np.asarray(np.kron(F, np.eye(3)), np.float64), np.asarray(np.kron(Q, shares), np.float64)


def velocity_covariance() -> NDArray[np.float64]:
    """Prior covariance (3, 3) of a target's velocity (m^2/s^2), ENU."""
    return SPEED_SIGMA**2 * np.diag(axes_shares())


def usual_modes() -> NDArray[np.float64]:
    """Probabilities (m,) of the modes of flight of a target of which nothing is known."""
    durations = np.array([mode.duration for mode in MODES])
    return durations / durations.sum()


def changes(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probabilities (k, m, m) that a target in one mode of flight (row) is in another one (column) after a time.

    A change leads to any mode by its usual probability, at rates that keep those.

    Parameters:
        steps (k,) (s): the times; amounts count.
    """
    usual = usual_modes()
    rate = sum(1.0 / mode.duration for mode in MODES) if len(usual) > 1 else 0.0
    stay = np.exp(-rate * np.abs(steps))[:, None, None]
    return np.asarray(stay * np.eye(len(usual)) + (1.0 - stay) * usual)


def mixing(weights: NDArray[np.float64], steps: NDArray[np.float64]
           ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Probabilities (k, m) of the modes after a time, and of each earlier mode (row) given the later one (column), (k, m, m).

    The first step of the interacting multiple model (Blom and Bar-Shalom 1988; Bar-Shalom, Li and Kirubarajan, Estimation with
    Applications to Tracking and Navigation, 2001, section 11.6.6).

    Parameters:
        weights (k, m): probabilities of the modes.
        steps: see `changes`.
    """
    joint = weights[:, :, None] * changes(steps)
    after = joint.sum(axis=1)
    return after, joint / after[:, None]


def mixed(shares: NDArray[np.float64], means: NDArray[np.float64], covariances: NDArray[np.float64]
          ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Moments (k, j, N) and (k, j, N, N) of mixtures of Gaussians.

    Parameters:
        shares (k, m, j): probabilities of the m components in each of j mixtures.
        means (k, m, N), covariances (k, m, N, N): of the components.
    """
    weights, (count, m, size) = shares.swapaxes(1, 2), means.shape
    mean = weights @ means
    apart = np.sqrt(weights)[..., None] * (means[:, None] - mean[:, :, None])  # (k, j, m, N)
    covariance = weights @ covariances.reshape(count, m, size * size)
    return mean, covariance.reshape(count, weights.shape[1], size, size) + apart.swapaxes(-1, -2) @ apart
