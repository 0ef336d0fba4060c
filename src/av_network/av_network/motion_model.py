"""Motion of targets: modes of flight with accelerations of some duration, and velocities that are slowly forgotten."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm


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
AXES_SHARES = np.array([1.0, 1.0, CLIMB_SHARE**2])  # variances of velocity and acceleration along east, north and up
VELOCITY_MEMORY_S = 16.0  # in which a velocity falls to 1 / e of itself, unless measured anew (decisions.md, several rigs)
LEAST_STEP_S = 0.05  # of a prediction: accelerations move a target by millimetres in less
LONGEST_STEP_S = 10.0  # more than a target lasts without reports; of longer ones the exponential would lose its precision


def motion(steps: NDArray[np.float64], dynamics: NDArray[np.float64], density: float
           ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transitions (k, n, n) and covariances (k, n, n) of dx = A x dt + dw, whose last element has white noise.

    Covariances by the exponential of one matrix (Van Loan, Computing integrals involving the matrix exponential, IEEE Trans.
    AC 23(3), 1978), which grows as what is forgotten and so loses digits that transitions by themselves keep.

    Parameters:
        steps (k,) (s): of time, not negative.
        dynamics (n, n): A.
        density: spectral density of the noise, in the square of the last element's unit over s.
    """
    n = len(dynamics)
    both = np.block([[-dynamics, np.zeros((n, n))], [np.zeros((n, n)), dynamics.T]])
    both[n - 1, 2 * n - 1] = density
    F = expm(steps[:, None, None] * dynamics)
    return F, F @ expm(steps[:, None, None] * both)[:, :n, n:]


def axis_motion(steps: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transitions (k, m, 3, 3) and noise's covariances of (position, velocity, acceleration) along a horizontal axis, by mode.

    The acceleration is exponentially correlated (Singer, Estimating optimal tracking filter performance for manned maneuvering
    targets, IEEE Trans. AES 6(4), 1970). A velocity is forgotten, so that its uncertainty stays finite while nothing is
    measured.

    Parameters:
        steps (k,) (s): of time; negative ones count as 0.
    """
    steps = np.clip(steps, 0.0, LONGEST_STEP_S)
    found = [motion(steps, np.array([[0.0, 1.0, 0.0], [0.0, -1.0 / VELOCITY_MEMORY_S, 1.0], [0.0, 0.0, -1.0 / mode.time]]),
                    2.0 * mode.sigma**2 / mode.time) for mode in MODES]
    F, Q = (np.stack(part, 1) for part in zip(*found, strict=True))
    return F, Q


def target_motion(step: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transitions (m, 9, 9) and covariances (m, 9, 9) of the noise of position, velocity and acceleration (ENU) in each mode.

    Parameters:
        step (s): of time.
    """
    F, Q = (part[0] for part in axis_motion(np.array([step])))
    return np.asarray(np.kron(F, np.eye(3)), np.float64), np.asarray(np.kron(Q, np.diag(AXES_SHARES)), np.float64)


def usual_modes() -> NDArray[np.float64]:
    """Probabilities (m,) of the modes of flight of a target of which nothing is known."""
    durations = np.array([mode.duration for mode in MODES])
    return durations / durations.sum()


def mixing(weights: NDArray[np.float64], steps: NDArray[np.float64]
           ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Probabilities (k, m) of the modes after a time, and of each earlier mode (row) given the later one (column), (k, m, m).

    A change leads to any mode by its usual probability, at rates that keep those. The first step of the interacting multiple
    model (Blom and Bar-Shalom 1988; Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation,
    2001, section 11.6.6).

    Parameters:
        weights (k, m): probabilities of the modes.
        steps (k,) (s): the times; negative ones count as 0.
    """
    usual, rate = usual_modes(), sum(1.0 / mode.duration for mode in MODES)
    stay = np.exp(-rate * np.maximum(steps, 0.0))[:, None, None]
    joint = weights[:, :, None] * (stay * np.eye(len(usual)) + (1.0 - stay) * usual)
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
