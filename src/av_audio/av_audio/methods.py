"""Estimators of directions of arrival by name; one of another package takes samples and array, and gives directions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_audio.steered_response import Peak
from av_common.angles import angles_to_direction
from av_common.methods import Methods
from av_common.microphone_array import MicrophoneArray

DOA_METHODS = Methods('av_rig.doa', dict.fromkeys(('ml', 'phat', 'plain', 'music', 'mvdr'), 'av_audio.estimators:METHODS'))


class Direction(NamedTuple):
    """One source in a window, as a method of another package reports it; its mirror images are found by the localizer.

    A calibrated array's delay curve is undone afterwards: the direction is that which the geometry alone gives.

    Parameters:
        azimuth (rad): in the array's frame, counter-clockwise from x.
        azimuth_variance (rad^2): of its error.
        elevation (rad): up from the horizontal plane.
        elevation_variance (rad^2): of its error; counts where the array resolves elevation.
        confidence: probability 0..1 that the direction stems from a source.
    """

    azimuth: float
    azimuth_variance: float
    elevation: float = 0.0
    elevation_variance: float = math.radians(10.0) ** 2
    confidence: float = 1.0


# Directions of one window, the strongest first, from its samples (n, channels) of full scale 1. An entry point of `av_rig.doa`
# names what makes one for a MicrophoneArray and a sample rate (Hz).
WindowMethod = Callable[[NDArray[np.float32]], Sequence[Direction]]


def peak_of(found: Direction, array: MicrophoneArray) -> Peak:
    """A direction as the projection on an array's basis that the array would measure.

    Parameters:
        found: the direction.
        array: the microphones.

    Raises ValueError for a direction that is none.
    """
    if not (all(map(math.isfinite, found)) and min(found.azimuth_variance, found.elevation_variance) > 0.0
            and 0.0 <= found.confidence <= 1.0):
        raise ValueError(f'{found}: expected finite angles, variances above 0 and a confidence of 0 to 1')
    step = 1e-4
    ahead, aside, above = (angles_to_direction(found.azimuth + a, found.elevation + e) @ array.basis
                           for a, e in ((0.0, 0.0), (step, 0.0), (0.0, step)))
    slopes = np.stack([aside - ahead, above - ahead], axis=1) / step
    variances = [found.azimuth_variance, found.elevation_variance if array.rank > 1 else 0.0]
    covariance = slopes @ np.diag(variances) @ slopes.T
    # Along the axis of a line of microphones its cosine changes with the square of the angle.
    covariance += 0.25 * found.azimuth_variance**2 * np.eye(array.rank)
    return Peak(ahead, covariance, np.zeros((array.rank, array.rank)), math.inf, found.confidence)
