"""Whether two channels of an array are exchanged, by the delays of sound between its microphones."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from av_common.acoustics import speed_of_sound
from av_common.microphone_array import MicrophoneArray

TOLERANCE = 0.05  # of the array's radius, by which positions and wavefronts are off
NEAREST = 1.5  # radii, of a source
OUTLIER = 3.0  # standard deviations


class ChannelOrder:
    """Hypotheses of two exchanged channels, each of which a plane wave fits, or does not.

    A plane wave arrives at times that are linear in the positions. Of m microphones that span r dimensions, m - 1 - r
    combinations of delays are 0, by each hypothesis others. Exchanges that are symmetries of the array, such as of opposite
    corners of a square, only mirror directions; they are no hypotheses, and of several that differ by such a symmetry none is
    better.

    Parameters:
        array: the microphones.
        sample_rate (Hz): sample rate.
        longer: factor by which delays may exceed those of the free field.
    """

    def __init__(self, array: MicrophoneArray, sample_rate: float, longer: float) -> None:
        centred, speed = array.positions - array.positions.mean(axis=0), speed_of_sound(20.0)
        self._squares = np.sum(centred**2, axis=1) / speed**2
        self._bend = 0.5 / (NEAREST * math.sqrt(float(self._squares.max())))
        shape, widths, _ = np.linalg.svd(centred, full_matrices=False)
        self._shape, self._longer = shape[:, :array.rank], longer
        self._crossing = widths[:array.rank] / speed
        self._sigma = math.hypot(0.5 / sample_rate, TOLERANCE * float(self._crossing[0]) / math.sqrt(array.channels))
        self._closure = OUTLIER * 0.5 * math.sqrt(array.channels) / sample_rate
        degrees = array.channels - 1 - array.rank    # of freedom of what is left: chi-square's mean, half its variance
        self._most = degrees + OUTLIER * math.sqrt(2.0 * degrees) if degrees > 0 else 0.0
        self._first, self._second = np.triu_indices(array.channels, 1)
        probes = np.random.default_rng(1).normal(size=(4, array.channels))
        explained = [np.sum(self._explained(probe) ** 2, axis=1) for probe in probes]
        self._classes = np.unique(np.round(explained, 6), axis=1, return_inverse=True)[1].reshape(-1)

    def exchanged(self, delays: NDArray, margin: float) -> list[tuple[int, int]] | None:
        """Pairs of channels of which one is exchanged; empty where the order is as described, None where that is not known.

        Parameters:
            delays (m,) (s): of each channel against the next, of the last against the first; NaN where not known.
            margin: by which the logarithm of a likelihood must exceed that of all other hypotheses.
        """
        if not self._most or not abs(delays.sum()) <= self._closure:
            return None
        times = -np.concatenate([[0.0], np.cumsum(delays - delays.mean())[:-1]])
        times -= times.mean()
        explained = self._explained(times)
        left = (times @ times - np.sum(explained**2, axis=1)) / self._sigma**2
        left[np.linalg.norm(explained / self._crossing, axis=1) > self._longer] = math.inf
        if self._left_by_near(times, times @ self._shape) <= self._most * self._sigma**2:
            return []
        best = int(np.argmin(left))
        same = self._classes == self._classes[best]
        if left[best] > self._most or (left[~same] < left[best] + 2.0 * margin).any():
            return None
        return [(int(self._first[k]), int(self._second[k])) for k in np.flatnonzero(same[1:])]

    def _left_by_near(self, times: NDArray, explained: NDArray) -> float:
        """Square (s^2) of arrival times (m,) that no wave of a source at any distance explains, by the described order.

        A source at R is later by (p^2 - (p u)^2) / (2 R c) at p than a plane wave from u.
        """
        plane = self._shape @ explained
        bent = self._squares - plane**2
        bent -= bent.mean() + self._shape @ (bent @ self._shape)
        left = times - plane
        share = float(bent @ left) / max(float(bent @ bent), 1e-300)
        return float(np.sum((left - min(max(share, 0.0), self._bend) * bent) ** 2))

    def _explained(self, times: NDArray) -> NDArray:
        """Parts (1 + p, r) of arrival times (m,) that a plane wave explains, by the described order and by each exchange."""
        change = (times[self._second] - times[self._first])[:, None] * (self._shape[self._first] - self._shape[self._second])
        return np.asarray(times @ self._shape + np.concatenate([np.zeros((1, change.shape[1])), change]))
