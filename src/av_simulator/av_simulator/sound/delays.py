"""Propagation delays between moving sources and microphones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from av_simulator.trajectories import Position

_INTERVAL = 80  # samples in which the delay is a cubic polynomial of time; its error is 1e-11 s at 20 m/s and 1 m
_NODES = np.array([0.0, 1.0, 2.0, 3.0]) / 3.0
_TO_COEFFICIENTS = np.linalg.inv(np.vander(_NODES, increasing=True))


def retarded_delay(position: Position, receivers: NDArray, times: NDArray, speed_of_sound: float) -> NDArray:
    """Travel times (s, (..., k)) of the sound that is received at `times`.

    They solve c * delay = |receiver - source(t - delay)| by the secant method, starting from a stationary source; the error
    is below 1e-10 s for speeds below 0.3 c. The distance at emission is `speed_of_sound` times the delay.

    Parameters:
        position: trajectory of the source.
        receivers (m, (..., k, 3)): positions in ENU at the times of reception.
        times (s, (k,)): times of reception.
        speed_of_sound (m/s): c.
    """
    shape = receivers.shape[:-1]

    def travel(delay: NDArray) -> NDArray:
        emitted = position((times - delay).ravel()).reshape(receivers.shape)
        away = receivers - emitted
        return np.sqrt(np.einsum('...i,...i->...', away, away)) / speed_of_sound

    earlier, travel_earlier = np.zeros(shape), travel(np.zeros(shape))
    delay, slope = travel_earlier, np.zeros(shape)
    for _ in range(3):
        now = travel(delay)
        change = delay - earlier
        known = np.abs(change) > 1e-13  # else the source is stationary or the delay has converged: keep the slope
        slope = np.where(known, (now - travel_earlier) / np.where(known, change, 1.0), slope)
        earlier, travel_earlier = delay, now
        delay = delay + (now - delay) / (1.0 - np.clip(slope, -0.9, 0.9))
    return delay


class BlockGrid:
    """The instants within a block at which delays are computed, and their cubic interpolation at every sample.

    For stationary microphones the intervals do not depend on the division of time into blocks. For moving ones they end at
    the block's ends, because positions after the block are unknown.

    Parameters:
        start: index of the first sample of the block.
        samples: number of samples of the block.
        moving: whether the microphones move.
    """

    def __init__(self, start: int, samples: int, moving: bool):
        stop = start + samples
        edges = np.arange(start // _INTERVAL, -(-stop // _INTERVAL) + 1) * float(_INTERVAL)
        if moving:
            edges = np.clip(edges, start, stop)
        left, width = edges[:-1], np.diff(edges)
        self.instants = left[:, None] + width[:, None] * _NODES  # (intervals, 4) in samples
        self.samples = index = np.arange(start, stop)
        self._interval = index // _INTERVAL - start // _INTERVAL
        self._place = (index - left[self._interval]) / width[self._interval]

    def to_samples(self, values: NDArray) -> NDArray:
        """Values (..., samples) interpolated from values (..., intervals, 4) at the instants."""
        coefficients = np.einsum('cn,...in->c...i', _TO_COEFFICIENTS, values)
        c0, c1, c2, c3 = np.take(coefficients, self._interval, axis=-1)
        return c0 + self._place * (c1 + self._place * (c2 + self._place * c3))


def along_block(positions: NDArray, start: int, samples: int, instants: NDArray) -> NDArray:
    """Positions (m, (m, *instants.shape, 3)) at instants of a block, by linear interpolation.

    Parameters:
        positions (m, (k, m, 3)): positions at k evenly spaced instants from the block's start to its end.
        start: index of the first sample of the block.
        samples: number of samples of the block.
        instants (samples): instants of any shape.
    """
    pieces = len(positions) - 1
    length = samples / pieces
    piece = np.clip(((instants - start) / length).astype(int), 0, pieces - 1)
    fraction = ((instants - (start + piece * length)) / length)[..., None, None]
    between = positions[piece] + fraction * (positions[piece + 1] - positions[piece])
    return np.moveaxis(between, -2, 0)
