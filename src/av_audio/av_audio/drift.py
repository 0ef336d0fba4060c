"""Motion within an analysis window: how far it shifts the direction of the whole window from that at its centre."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from av_audio.baselines import Baselines
from av_audio.spectra import TINY, Blocks
from av_common.microphone_array import MicrophoneArray

# Distance of the blocks of a window: so short that neither direction nor loudness change much within one, and much longer
# than any delay.
BLOCK_S = 0.03125
# In windows of fewer blocks, below 80 ms, nothing moves far: 2 deg at 1 rad/s to either side.
LEAST_BLOCKS = 3
# Bins of a block that are summed, as their errors are correlated: twice the width of a block's spectral lines, 1 / (2 BLOCK_S).
CLUSTER_HZ = 64.0
# Standard deviations of the rate of q in 1/s and of its acceleration in 1/s^2, if anything moves. q is the sine of the angle
# from broadside: there they are those of the angle in rad. A drone that passes at 10 m/s, 25 m away, has 0.4 and up to 0.1; a
# rig that looks for it turns at 0.5 rad/s, and begins and ends that within a second.
PRIOR_RATE = 0.4
PRIOR_ACCELERATION = 0.5
PRIOR_MOVES = 0.1  # probability that anything moves: few windows at rest are then taken for motion by chance
HIGHEST_RATE = 2.6  # that is searched: 150 deg/s, as fast as a pilot turns a multirotor (MPC_MAN_Y_MAX of PX4)
GRID_POINTS_PER_PERIOD = 8.0  # of the highest frequency; with 4 one more of 46 windows of noise passes


@dataclass(frozen=True)
class Drift:
    """Motion of q within a window, and its effect on an estimate from the whole window.

    Parameters:
        shift (rank,): expected q of the whole window less that at its centre.
        covariance (rank, rank): its covariance.
        moves: probability that anything moves.
    """

    shift: NDArray
    covariance: NDArray
    moves: float


@dataclass(frozen=True)
class Fit:
    """The blocks' correlation at a motion (3, rank): deviation of q, rate and acceleration.

    Parameters:
        motion (3, rank): the motion.
        height: the correlation.
        hessian (3 rank, 3 rank): its negative Hessian.
        scores (3 rank, c): its gradient in each cluster of bins.
    """

    motion: NDArray
    height: float
    hessian: NDArray
    scores: NDArray

    @cached_property
    def usable(self) -> bool:
        """Whether the correlation has a maximum in q."""
        rank = self.motion.shape[1]
        return self.height > 0.0 and is_positive(self.hessian[:rank, :rank]) and bool(self.scores[:rank].any())

    @cached_property
    def scale(self) -> float:
        """Correlation per unit of log-likelihood: the scatter of the scores over that of a likelihood."""
        rank = self.motion.shape[1]
        return float(np.sum(self.scores[:rank] ** 2) / np.trace(self.hessian[:rank, :rank]))


class DriftEstimator:
    """Rate v and acceleration a of q = q0 + v t + a t^2 / 2 within a window, from the phases of its blocks.

    A sound that is louder in one part of the window than in another gives the direction of that part. The window is cut
    into overlapping blocks, whose cross-spectra, weighted as those of the window, form one function of q0, v and a. Its
    maximum is found as that of the steered response. Whether anything moves is uncertain: the posterior is a mixture of
    rest and motion (v and a normal, the mean of a that of a great circle), so that at rest the estimate from the whole
    window stays as it is.

    Parameters:
        array: positions of the microphones.
        frequencies (k,) (Hz): frequencies of the window's bins.
        speed_of_sound (m/s): speed of sound.
    """

    def __init__(self, array: MicrophoneArray, frequencies: NDArray, speed_of_sound: float) -> None:
        self._blocks = Blocks(frequencies, BLOCK_S)
        self._baselines = Baselines(array)
        self._slowness = self._baselines.vectors @ array.basis / speed_of_sound  # (u, rank): tau = slowness . q
        self._rate_of_delays = np.linalg.pinv(self._slowness)
        times = self._blocks.times
        self._powers = np.stack([np.ones_like(times), times, 0.5 * times**2])  # (3, b): of q0, v and a
        block_hz = self._blocks.spacing * float(frequencies[1] - frequencies[0])
        self._width = max(1, round(CLUSTER_HZ / block_hz))
        used = len(self._blocks.frequencies) // self._width * self._width
        self._nearest = np.floor(np.arange(used) * self._blocks.spacing).astype(int)  # bins of the window at the blocks' bins
        omega = 2.0 * np.pi * self._blocks.frequencies[:used]
        self._omega = omega.astype(np.float32)
        self._cluster_omega = omega.reshape(-1, self._width).mean(axis=1).astype(np.float32)
        self._precision = np.repeat([0.0, PRIOR_RATE**-2, PRIOR_ACCELERATION**-2], array.rank)  # of q, rate and acceleration
        reach = HIGHEST_RATE * array.aperture / speed_of_sound
        points = int(np.ceil(GRID_POINTS_PER_PERIOD * frequencies[-1] * times[-1] * reach))
        self._delay_rates = np.linspace(-reach, reach, 2 * points + 1)
        angles = np.multiply.outer(self._delay_rates, np.multiply.outer(times, self._cluster_omega))
        self._turns = np.exp(-1j * angles).astype(np.complex64)  # (g, b, c)
        self.usable = self._blocks.count > LEAST_BLOCKS and len(self._cluster_omega) >= 3 * array.rank

    def estimate(self, spectra: NDArray, weights: NDArray, q: NDArray) -> Drift | None:
        """Motion about the centre of a window; None where none can be found, as at rest.

        Parameters:
            spectra (m, k): spectra of the window.
            weights (p, k): weights of its cross-spectra, in the order of `Baselines.pairs`.
            q (rank,): direction of the whole window.
        """
        rank = len(q)
        cross = self._cross_spectra(spectra, weights, q)
        rest = self._fit(cross, np.zeros((3, rank)))
        fit = self._fit(cross, self._start(cross, q))
        expected = np.concatenate([np.zeros(2 * rank), -square_speed(q, fit.motion[1]) * q])
        hessian = self._of_posterior(fit)
        if not is_positive(hessian):
            return None
        gradient = fit.scores.sum(axis=1) - fit.scale * self._precision * (fit.motion.ravel() - expected)
        fit = self._fit(cross, fit.motion + np.linalg.solve(hessian, gradient).reshape(3, rank))
        return self._posterior(rest, fit, expected)

    def _of_posterior(self, fit: Fit) -> NDArray:
        """Negative Hessian (3 rank, 3 rank) of the posterior times the fit's scale; not positive without a maximum."""
        return fit.hessian + np.diag(fit.scale * self._precision) if fit.usable else -np.ones((1, 1))

    def _cross_spectra(self, spectra: NDArray, weights: NDArray, q: NDArray) -> NDArray:
        """Weighted cross-spectra (u, b, c) of the blocks, steered to q and summed over clusters of bins."""
        # weighted before it is cut: strong frequencies would leak into weak ones
        mean = np.maximum(weights.mean(axis=0), TINY)
        blocks = self._blocks.spectra(spectra * np.sqrt(mean))[..., :len(self._omega)]  # (m, b, used)
        first, second = self._baselines.pairs.T
        cross = self._baselines.sum(blocks[first] * blocks[second].conj() * (weights / mean)[:, None, self._nearest])
        angles = (self._slowness @ q).astype(np.float32)[:, None] * self._omega
        cross *= (np.cos(angles) - 1j * np.sin(angles))[:, None]
        return sum(cross[..., k::self._width] for k in range(1, self._width)) + cross[..., ::self._width]

    def _start(self, cross: NDArray, q: NDArray) -> NDArray:
        """Motion (3, rank) on a great circle with the rate that follows from the best rate of each pair's delay.

        q is the direction at the time of most of the energy.
        """
        energy = np.abs(cross.sum(axis=-1)).sum(axis=0)
        centre = float(self._powers[1] @ energy / max(float(energy.sum()), TINY))
        turned = (cross[:, None] * self._turns).sum(axis=2)  # without the threads of BLAS, which cost more than they gain
        angles = np.multiply.outer(centre * self._delay_rates, self._cluster_omega).astype(np.float32)
        curves = np.sum(turned.real * np.cos(angles) - turned.imag * np.sin(angles), axis=-1)
        rate = self._rate_of_delays @ self._delay_rates[np.argmax(curves, axis=1)]
        return np.stack([-centre * rate, rate, -square_speed(q, rate) * q])

    def _fit(self, cross: NDArray, motion: NDArray) -> Fit:
        angles = (self._slowness @ motion.T @ self._powers).astype(np.float32)[..., None] * self._cluster_omega
        steered = cross * (np.cos(angles) - 1j * np.sin(angles))
        second = steered.real @ self._cluster_omega**2  # (u, b)
        first = self._powers @ (steered.imag * self._cluster_omega)  # (u, 3, c)
        moments = (self._powers[:, None] * self._powers) @ second.T  # (3, 3, u)
        hessian = np.einsum('pr,nmp,ps->nrms', self._slowness, moments, self._slowness).reshape(motion.size, motion.size)
        scores = np.einsum('pr,pnc->nrc', self._slowness, first).reshape(motion.size, -1)
        return Fit(motion, float(steered.real.sum()), hessian, scores)

    def _posterior(self, rest: Fit, fit: Fit, expected: NDArray) -> Drift | None:
        """The drift, given the maximum of the posterior of a motion (Laplace's approximation); None where that is none."""
        rank = fit.motion.shape[1]
        hessian = self._of_posterior(fit)
        if not (rest.usable and is_positive(hessian)):
            return None
        lever = np.linalg.solve(fit.hessian[:rank, :rank], fit.hessian[:rank, rank:])
        information = (hessian[rank:, rank:] - hessian[rank:, :rank] @ lever) / fit.scale  # of rate and acceleration
        deviation = (fit.motion.ravel() - expected)[rank:]
        precision = self._precision[rank:]
        log_odds = np.log(PRIOR_MOVES / (1.0 - PRIOR_MOVES)) + (fit.height - rest.height) / fit.scale
        log_odds -= 0.5 * float(deviation @ (precision * deviation))
        log_odds -= 0.5 * float(np.linalg.slogdet(information)[1] - np.sum(np.log(precision)))
        moves = 1.0 / (1.0 + np.exp(-np.clip(log_odds, -50.0, 50.0)))
        shift = -fit.motion[0]
        spread = lever @ np.linalg.solve(information, lever.T) + (1.0 - moves) * np.outer(shift, shift)
        return Drift(moves * shift, moves * spread, moves)


def square_speed(q: NDArray, rate: NDArray) -> float:
    """Square of the angular speed in rad^2/s^2 on the great circle on which q (rank,) moves at a rate (rank,) in 1/s."""
    unseen = float(q @ rate) ** 2 / max(1.0 - float(q @ q), TINY) if len(q) < 3 else 0.0  # arrays in space see all of it
    return min(float(rate @ rate) + unseen, HIGHEST_RATE**2)


def is_positive(matrix: NDArray) -> bool:
    """Whether a symmetric matrix is positive definite beyond the rounding of single precision: its pivots against its diagonal.

    Without a microphone, the others may measure nothing along an axis.
    """
    try:
        pivots = np.linalg.cholesky(matrix).diagonal() ** 2
    except np.linalg.LinAlgError:
        return False
    return bool((pivots > len(matrix) * np.finfo(np.float32).eps * matrix.diagonal()).all())
