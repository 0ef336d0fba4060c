"""Calibration of a pair of microphones, with a body between them, from a source at known azimuths."""

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

# Degree of the polynomial in the cosine of the angle. One further term is the angle itself, as a sphere requires
# (Woodworth, 1938).
DEGREE = 3
STIFFNESS = 0.02  # regularises terms that the data do not determine
MIN_ANGLES = 10
# A body may lengthen the delay beyond that of the straight line; the search covers this factor.
SEARCH_STRETCH = 1.5
MIN_CONFIDENCE = 0.9


@dataclass(frozen=True)
class Calibration:
    """Result of a calibration.

    Parameters:
        array: array with fitted positions and delay curve.
        baseline (m): fitted distance of the microphones.
        axis_offset (rad): rotation of the axis, counter-clockwise.
        residuals (n,) (rad): errors of the angle to the axis.
    """

    array: MicrophoneArray
    baseline: float
    axis_offset: float
    residuals: NDArray

    def report(self) -> str:
        """Summary in three lines."""
        residuals = np.degrees(np.abs(self.residuals))
        return (f'baseline      {1e3 * self.baseline:.1f} mm\n'
                f'axis offset   {np.degrees(self.axis_offset):+.2f} deg\n'
                f'residuals     {residuals.size} angles, median {np.median(residuals):.2f} deg, '
                f'RMS {np.sqrt(np.mean(residuals**2)):.2f} deg, largest {residuals.max():.2f} deg')


def search_array(array: MicrophoneArray) -> MicrophoneArray:
    """The array with which delays for `calibrate` are measured: no delay curve, and long enough for the longest delays."""
    return MicrophoneArray(_stretched_and_rotated(array, SEARCH_STRETCH, 0.0), array.name)


def measured_path(array: MicrophoneArray, estimates: Iterable[DoaEstimate]) -> tuple[NDArray, NDArray]:
    """Times (n,) in s and path differences c tau (n,) in m of confident estimates that were made with `search_array(array)`.

    Parameters:
        array: the pair with its nominal positions.
        estimates: estimates made with `search_array(array)`.

    Raises ValueError when no estimate is confident.
    """
    kept = [(estimate.time, estimate.q[0]) for estimate in estimates
            if len(estimate.confidence) and estimate.confidence[0] >= MIN_CONFIDENCE]
    if not kept:
        raise ValueError(f'no estimate reaches a confidence of {MIN_CONFIDENCE}: the recording is too quiet or too noisy')
    times, cosines = np.array(kept).T
    return times, cosines * search_array(array).aperture


def calibrate(array: MicrophoneArray, azimuths: ArrayLike, paths: ArrayLike) -> Calibration:
    """Fit baseline, axis and delay curve of a pair.

    Parameters:
        array: the pair with its nominal positions.
        azimuths (n,) (rad): true azimuths of the source in the array's frame.
        paths (n,) (m): measured path differences c tau, see `measured_path`.

    Raises ValueError when the array is not a pair or the azimuths do not determine the fit.
    """
    if array.channels != 2:
        raise ValueError(f'calibration needs two microphones, {array.name} has {array.channels}')
    azimuths, paths = np.asarray(azimuths, dtype=float), np.asarray(paths, dtype=float)
    axis = np.arctan2(array.basis[1, 0], array.basis[0, 0])
    spread = np.ptp(np.cos(azimuths - axis))
    if azimuths.size < MIN_ANGLES or spread < 1.2:
        raise ValueError(f'{azimuths.size} angles that span {spread:.1f} of the 2.0 between both ends of the axis; '
                         f'at least {MIN_ANGLES} that span 1.2 are needed')

    def misfit(parameters: NDArray) -> NDArray:
        offset, *coefficients = parameters
        curve = _terms(np.cos(azimuths - axis - offset)) @ coefficients
        return np.concatenate([curve - paths / array.aperture, STIFFNESS * np.array(coefficients[2:])])

    start = np.zeros(DEGREE + 3)
    start[2] = 1.0
    # a robust loss, as recordings contain single wrong peaks
    offset, *coefficients = least_squares(misfit, start, loss='soft_l1', f_scale=0.02).x
    grid = -np.cos(np.linspace(0.0, np.pi, 61))
    grid[[0, -1]] = -1.0, 1.0
    measured = _terms(grid) @ coefficients
    stretch = float(np.ptp(measured) / 2.0)
    delay_curve = DelayCurve(grid, measured / stretch)
    fitted = MicrophoneArray(_stretched_and_rotated(array, stretch, offset), array.name, delay_curve)
    angles = np.arccos(np.clip(delay_curve.true_cosine(paths / fitted.aperture), -1.0, 1.0))
    residuals = angles - np.abs(wrap(azimuths - axis - offset))
    return Calibration(fitted, fitted.aperture, float(offset), residuals)


def _terms(cosines: NDArray) -> NDArray:
    """Terms (n, DEGREE + 2) of the delay curve at cosines (n,) of the angle to the axis."""
    return np.column_stack([chebyshev.chebvander(cosines, DEGREE), np.arcsin(cosines)])


def _stretched_and_rotated(array: MicrophoneArray, stretch: float, rotation: float) -> NDArray:
    """Positions (m, 3) stretched about their centre and rotated (rad) counter-clockwise as seen from above."""
    centre = array.positions.mean(axis=0)
    cosine, sine = np.cos(rotation), np.sin(rotation)
    matrix = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return centre + stretch * (array.positions - centre) @ matrix.T
