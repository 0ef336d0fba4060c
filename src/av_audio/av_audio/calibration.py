"""What a body between two microphones does to their delay, learnt from a source at known azimuths."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from av_audio.localizer import DoaEstimate
from av_common.angles import wrap
from av_common.microphone_array import DelayCurve, MicrophoneArray

# Degree of the polynomial in the angle's cosine; the angle itself is one more term, which is what a sphere adds
# (Woodworth, 1938).
DEGREE = 3
STIFFNESS = 0.02  # keeps terms small that the data do not determine
LEAST_ANGLES = 10
# A body may make the delay longer than the straight line; the search has to reach that far.
SEARCH_STRETCH = 1.5
LEAST_CONFIDENCE = 0.9


@dataclass(frozen=True)
class Calibration:
    """The array with fitted positions and delay curve, and what the fit left over.

    residuals: (n,) rad of the angle to the axis; baseline in m; axis_offset in rad, counter-clockwise.
    """

    array: MicrophoneArray
    baseline: float
    axis_offset: float
    residuals: NDArray

    def report(self) -> str:
        """A few lines for people."""
        residuals = np.degrees(np.abs(self.residuals))
        return (f'baseline      {1e3 * self.baseline:.1f} mm\n'
                f'axis offset   {np.degrees(self.axis_offset):+.2f} deg\n'
                f'residuals     {residuals.size} angles, median {np.median(residuals):.2f} deg, '
                f'RMS {np.sqrt(np.mean(residuals**2)):.2f} deg, largest {residuals.max():.2f} deg')


def search_array(array: MicrophoneArray) -> MicrophoneArray:
    """The array with which to measure delays for `calibrate`: straight, and long enough to find bent delays."""
    return MicrophoneArray(_turned(array, SEARCH_STRETCH, 0.0), array.name)


def measured_path(array: MicrophoneArray, estimates: Iterable[DoaEstimate]) -> tuple[NDArray, NDArray]:
    """Times (n,) in s and path differences c tau (n,) in m of the confident estimates made with `search_array`."""
    kept = [(estimate.time, estimate.q[0]) for estimate in estimates
            if len(estimate.confidence) and estimate.confidence[0] >= LEAST_CONFIDENCE]
    if not kept:
        raise ValueError(f'no estimate reaches a confidence of {LEAST_CONFIDENCE}: the recording is too quiet or noisy')
    times, cosines = np.array(kept).T
    return times, cosines * search_array(array).aperture


def calibrate(array: MicrophoneArray, azimuths: ArrayLike, paths: ArrayLike) -> Calibration:
    """Fit baseline, axis and delay curve to path differences c tau (n,) in m measured at azimuths (n,) in rad.

    Raises ValueError when the array is not a pair or the azimuths cannot determine the fit.
    """
    if array.channels != 2:
        raise ValueError(f'calibration is for two microphones, {array.name} has {array.channels}')
    azimuths, paths = np.asarray(azimuths, dtype=float), np.asarray(paths, dtype=float)
    axis = np.arctan2(array.basis[1, 0], array.basis[0, 0])
    spread = np.ptp(np.cos(azimuths - axis))
    if azimuths.size < LEAST_ANGLES or spread < 1.2:
        raise ValueError(f'{azimuths.size} angles that span {spread:.1f} of the 2.0 between both ends of the axis; '
                         f'at least {LEAST_ANGLES} that span 1.2 are needed')

    def misfit(parameters: NDArray) -> NDArray:
        offset, *coefficients = parameters
        curve = _terms(np.cos(azimuths - axis - offset)) @ coefficients
        return np.concatenate([curve - paths / array.aperture, STIFFNESS * np.array(coefficients[2:])])

    start = np.zeros(DEGREE + 3)
    start[2] = 1.0
    # robust, as single wrong peaks happen in a recording
    offset, *coefficients = least_squares(misfit, start, loss='soft_l1', f_scale=0.02).x
    grid = -np.cos(np.linspace(0.0, np.pi, 61))
    grid[[0, -1]] = -1.0, 1.0
    measured = _terms(grid) @ coefficients
    stretch = float(np.ptp(measured) / 2.0)
    fitted = MicrophoneArray(_turned(array, stretch, offset), array.name, DelayCurve(grid, measured / stretch))
    angles = np.arccos(np.clip(fitted.delay_curve.true_cosine(paths / fitted.aperture), -1.0, 1.0))
    residuals = angles - np.abs(wrap(azimuths - axis - offset))
    return Calibration(fitted, fitted.aperture, float(offset), residuals)


def _terms(cosines: NDArray) -> NDArray:
    """The delay curve's terms (n, DEGREE + 2) at cosines (n,) of the angle to the axis."""
    return np.column_stack([chebyshev.chebvander(cosines, DEGREE), np.arcsin(cosines)])


def _turned(array: MicrophoneArray, stretch: float, turn: float) -> NDArray:
    """Positions stretched about their centre and turned counter-clockwise seen from above."""
    centre = array.positions.mean(axis=0)
    cosine, sine = np.cos(turn), np.sin(turn)
    rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return centre + stretch * (array.positions - centre) @ rotation.T
