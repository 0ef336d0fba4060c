"""Calibration of a pair of microphones, with a body between them, from a source at known azimuths.

Consensus finds the curve that most estimates agree with; an M-estimator refines it among curves that rise by construction.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import lsq_linear
from scipy.stats import binom, norm

from av_audio.localizer import DoaEstimate
from av_common.acoustics import BODY_STRETCH
from av_common.angles import wrap
from av_common.microphone_array import DelayCurve, MicrophoneArray

MIN_SPREAD = 1.0    # of the cosines of the angles, of 2 between both ends of the axis
MIRRORED = -0.7    # correlation of cosines and paths: those of exchanged sides explain half of what paths differ by
MIN_CONFIDENCE = 0.9    # as of directions that fusion uses
# Consensus: trials of two estimates for each rotation of the axis, and the largest misfit in baselines that agrees. With steps
# of 5 degrees or 50 trials no error changes by a tenth; half of the misfit makes those of few estimates a fifth larger.
ROTATIONS = np.radians(np.arange(-30.0, 30.1, 2.0))
TRIALS = 150
AGREEMENT = 0.06
# Degree of the Bernstein polynomial in the angle to the axis; it falls where its coefficients fall (Farouki, 2012).
DEGREE = 10
MIN_ANGLES = DEGREE    # of estimates that agree: one for each step of the curve
LEAST_STEP = 1e-3    # between two coefficients, in baselines
STIFFNESS = 0.03    # holds terms that the data do not determine; a third or three times as much changes errors by a fifth
FITS = 12    # iterations; 4 give the same errors
# Tukey's biweight: estimates beyond this many standard deviations are outliers (95 % efficient for normal errors, Holland and
# Welsch, 1977); and the least standard deviation in baselines.
BIWEIGHT = 4.685
LEAST_SCALE = 0.008
# Scatter about the curve: largest misfit in baselines that is none of a wrong estimate, width in baselines in which paths
# count, weight of all others, and quantile of the misfits.
LARGEST_MISFIT = 0.36
NEAR, ELSEWHERE = 0.06, 1e-3
QUANTILE = 0.8
# Places of the source that are left out together, by the angle to the axis, and in how many parts all of them are left out.
PLACE, PARTS = np.radians(10.0), 5


@dataclass(frozen=True)
class Calibration:
    """Result of a calibration.

    Parameters:
        array: array with fitted positions and delay curve.
        nominal: distance of the microphones before, in m.
        axis_offset (rad): rotation of the axis, counter-clockwise.
        angles (n,) (rad): true angles to the fitted axis.
        residuals (n,) (rad): errors of the angle to the axis.
        outliers (n,): which estimates contradict the fit.
        left_out (n,) (rad): errors of the angle by curves that were fitted to other places.
        before (n,) (rad): errors of the angle by the array as it was, most often of a straight line.
    """

    array: MicrophoneArray
    nominal: float
    axis_offset: float
    angles: NDArray
    residuals: NDArray
    outliers: NDArray[np.bool_]
    left_out: NDArray
    before: NDArray

    @property
    def baseline(self) -> float:
        """Fitted distance of the microphones in m."""
        return self.array.aperture

    def report(self) -> str:
        """Summary in five lines."""
        residuals = np.degrees(np.abs(self.residuals[~self.outliers]))
        return (f'baseline      {1e3 * self.baseline:.1f} mm\n'
                f'axis offset   {np.degrees(self.axis_offset):+.2f} deg\n'
                f'residuals     {residuals.size} angles, median {np.median(residuals):.2f} deg, '
                f'RMS {np.sqrt(np.mean(residuals**2)):.2f} deg, largest {residuals.max():.2f} deg\n'
                f'outliers      {np.count_nonzero(self.outliers)} of {self.outliers.size}\n'
                f'other places  mean error {np.degrees(np.abs(self.left_out).mean()):.2f} deg, '
                f'{np.degrees(np.abs(self.before).mean()):.2f} deg without calibration')


def search_array(array: MicrophoneArray) -> MicrophoneArray:
    """The array with which delays for `calibrate` are measured: no delay curve, and long enough for the longest delays."""
    return MicrophoneArray(_stretched_and_rotated(array, BODY_STRETCH, 0.0), array.name)


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
    """Fit baseline, axis and delay curve of a pair. Up to half of the estimates may be outliers.

    Parameters:
        array: the pair with its nominal positions.
        azimuths (n,) (rad): true azimuths of the source in the array's frame.
        paths (n,) (m): measured path differences c tau, see `measured_path`.

    Raises ValueError when the array is not a pair, or the azimuths do not determine the fit, or hardly two paths agree, or left
    and right are exchanged.
    """
    if array.channels != 2:
        raise ValueError(f'calibration needs two microphones, {array.name} has {array.channels}')
    azimuths, paths = np.asarray(azimuths, dtype=float), np.asarray(paths, dtype=float)
    axis = np.arctan2(array.basis[1, 0], array.basis[0, 0])
    spread = np.ptp(np.cos(azimuths - axis)) if azimuths.size else 0.0
    if azimuths.size < MIN_ANGLES or spread < MIN_SPREAD:
        in_radians = azimuths.size and np.degrees(np.abs(azimuths).max()) <= np.pi
        raise ValueError(f'{azimuths.size} angles that span {spread:.1f} of the 2.0 between both ends of the axis; '
                         f'at least {MIN_ANGLES} that span {MIN_SPREAD} are needed'
                         f'{": are the azimuths in degrees?" if in_radians else ""}')
    relative = paths / array.aperture
    if np.corrcoef(np.cos(azimuths - axis), relative)[0, 1] < MIRRORED:
        raise ValueError('left and right are exchanged: give the channels in the order of the array file (--channels 1 0), or '
                         'azimuths counter-clockwise')
    coefficients, offset, outliers = _fit(azimuths - axis, relative)
    grid = np.linspace(np.pi, 0.0, 61)
    measured = _bernstein(grid) @ coefficients
    stretch = float(np.ptp(measured) / 2.0)
    angles = np.abs(wrap(azimuths - axis - offset))
    scatter = _scatter(measured, relative, np.abs(_bernstein(angles) @ coefficients - relative))
    curve = DelayCurve(_cosines(grid), measured / stretch, tuple((scatter / stretch).tolist()))
    fitted = MicrophoneArray(_stretched_and_rotated(array, stretch, offset), array.name, curve)
    known = relative if array.delay_curve is None else array.delay_curve.true_cosine(relative)
    before = np.arccos(np.clip(known, -1.0, 1.0)) - np.abs(wrap(azimuths - axis))
    return Calibration(fitted, array.aperture, offset, angles, _heard(coefficients, relative) - angles, outliers,
                       _left_out(azimuths - axis, relative), before)


def _fit(azimuths: NDArray, paths: NDArray) -> tuple[NDArray, float, NDArray[np.bool_]]:
    """Bernstein coefficients, rotation of the axis and outliers; parameters as of `_refine`."""
    return _refine(azimuths, paths, *_consensus(azimuths, paths))


def _left_out(azimuths: NDArray, paths: NDArray) -> NDArray:
    """Errors (n,) in rad of the angle at each place, by a fit to the others; right angles where these allow none.

    Cross-validation (Stone, 1974) by places, as successive estimates at one place share their reflections.
    """
    parts = (np.abs(wrap(azimuths)) // PLACE).astype(int) % PARTS
    errors = np.full(len(paths), 0.5 * np.pi)
    for part in np.unique(parts):
        own = parts == part
        try:
            coefficients, offset, _ = _fit(azimuths[~own], paths[~own])
        except ValueError:
            continue
        errors[own] = _heard(coefficients, paths[own]) - np.abs(wrap(azimuths[own] - offset))
    return errors


def _heard(coefficients: NDArray, paths: NDArray) -> NDArray:
    """Angles (n,) to the axis at which paths (n,) are heard by a curve."""
    grid = np.linspace(np.pi, 0.0, 61)
    return np.arccos(np.interp(paths, _bernstein(grid) @ coefficients, _cosines(grid)))


def _cosines(grid: NDArray) -> NDArray:
    """Cosines of angles that fall from pi to 0."""
    return np.concatenate([[-1.0], np.cos(grid[1:-1]), [1.0]])


def _consensus(azimuths: NDArray, paths: NDArray) -> tuple[float, NDArray]:
    """Rotation of the axis in rad and weights (2,) of cosine and angle of the curve that most estimates agree with.

    The curve is that of a sphere (Woodworth, 1938) with any ratio of both terms. Two estimates determine it, as in RANSAC
    (Fischler and Bolles, 1981); the score limits each misfit (MSAC, Torr and Zisserman, 2000).

    Parameters:
        azimuths (n,) (rad): true azimuths from the nominal axis.
        paths (n,): path differences in nominal baselines.
    """
    rng = np.random.default_rng(0)
    best = np.inf, 0.0, np.array([1.0, 0.0])
    picked = rng.integers(len(paths), size=(TRIALS, 2))
    for rotation in ROTATIONS:
        terms = _terms(np.abs(wrap(azimuths - rotation)))
        chosen = terms[picked]
        solvable = np.abs(np.linalg.det(chosen)) > 1e-6
        candidates = np.linalg.solve(chosen[solvable], paths[picked[solvable], None])[..., 0]
        candidates = candidates[(candidates >= -1e-9).all(axis=1) & (candidates.sum(axis=1) > 0.1)]
        if not len(candidates):
            continue
        misfits = np.minimum((candidates @ terms.T - paths) ** 2, AGREEMENT**2).mean(axis=1)
        least = int(np.argmin(misfits))
        # between equal fits, the smaller rotation
        score = float(misfits[least]) + 1e-3 * AGREEMENT**2 * abs(rotation)
        if score < best[0]:
            best = score, float(rotation), candidates[least]
    return best[1], best[2]


def _refine(azimuths: NDArray, paths: NDArray, offset: float, weights: NDArray
            ) -> tuple[NDArray, float, NDArray[np.bool_]]:
    """Bernstein coefficients (DEGREE + 1,) of the path by angle, rotation of the axis, outliers (n,).

    Iteratively reweighted least squares with Tukey's biweight. The coefficients fall by at least LEAST_STEP.

    Parameters:
        azimuths (n,) (rad): true azimuths from the nominal axis.
        paths (n,): path differences in nominal baselines.
        offset (rad), weights (2,): from `_consensus`.
    """
    grid = np.linspace(0.0, np.pi, 61)
    model = np.linalg.lstsq(_bernstein(grid), _terms(grid) @ weights, rcond=None)[0]
    to_coefficients = np.tril(np.ones((DEGREE + 1, DEGREE + 1)))    # of the first one and the (negative) steps
    to_coefficients[:, 1:] *= -1.0
    curvature = np.diff(np.eye(DEGREE + 1), 2, axis=0)
    coefficients = model
    scale = AGREEMENT / 2.0
    for _ in range(FITS):
        signed = wrap(azimuths - offset)
        basis = _bernstein(np.abs(signed))
        residuals = basis @ coefficients - paths
        kept = np.abs(residuals) < BIWEIGHT * scale
        if np.count_nonzero(kept) < MIN_ANGLES:
            raise ValueError(f'{np.count_nonzero(kept)} of {len(paths)} estimates agree, at least {MIN_ANGLES} are needed')
        root = np.where(kept, 1.0 - (residuals / (BIWEIGHT * scale)) ** 2, 0.0)    # of the biweight
        turn = -np.sign(signed) * (_bernstein_slope(np.abs(signed)) @ coefficients)
        stiffness = STIFFNESS * np.sqrt(np.sum(root**2))
        matrix = np.block([
            [root[:, None] * basis @ to_coefficients, (root * turn)[:, None]],
            [stiffness * curvature @ to_coefficients, np.zeros((len(curvature), 1))],
            [np.zeros((1, DEGREE + 1)), np.array([[stiffness]])]])
        target = np.concatenate([root * paths, stiffness * curvature @ model, [0.0]])
        low = np.concatenate([[-np.inf], np.full(DEGREE, LEAST_STEP), [-0.05]])
        high = np.concatenate([np.full(DEGREE + 1, np.inf), [0.05]])
        solution = lsq_linear(matrix, target, (low, high)).x
        coefficients = to_coefficients @ solution[:-1]
        offset += float(solution[-1])
        misfits = np.abs(_bernstein(np.abs(wrap(azimuths - offset))) @ coefficients - paths)
        scale = max(LEAST_SCALE, 1.4826 * float(np.median(misfits[misfits < 2.0 * AGREEMENT])))
    return coefficients, offset, misfits > BIWEIGHT * scale


def _scatter(places: NDArray, paths: NDArray, misfits: NDArray) -> NDArray:
    """Standard deviation (k,) of the paths about the curve at places (k,) on it, in nominal baselines.

    Of what is measured near each place it is that of a normal distribution with the same quantile. Beside an ear, where front
    and back differ most, it is much larger than elsewhere.

    Parameters:
        places (k,): path differences on the curve.
        paths (n,): measured path differences.
        misfits (n,): their distances from the curve.
    """
    kept = np.argsort(misfits)[:np.count_nonzero(misfits < LARGEST_MISFIT)]
    apart = np.clip(paths[kept], places.min(), places.max()) - places[:, None]
    weights = np.exp(-0.5 * (apart / NEAR) ** 2) + ELSEWHERE
    reached = np.cumsum(weights, axis=1) >= QUANTILE * weights.sum(axis=1, keepdims=True)
    return np.maximum(misfits[kept][np.argmax(reached, axis=1)] / norm.ppf(0.5 + 0.5 * QUANTILE), LEAST_SCALE)


def _terms(angles: NDArray) -> NDArray:
    """Cosine (..., 0) and angle from broadside (..., 1) of angles to the axis in rad."""
    return np.stack([np.cos(angles), 0.5 * np.pi - angles], axis=-1)


def _bernstein(angles: NDArray, degree: int = DEGREE) -> NDArray:
    """Bernstein polynomials (n, degree + 1) at angles (n,) from 0 to pi."""
    return binom.pmf(np.arange(degree + 1), degree, np.clip(np.asarray(angles)[:, None] / np.pi, 0.0, 1.0))


def _bernstein_slope(angles: NDArray) -> NDArray:
    """Derivatives (n, DEGREE + 1) of the Bernstein polynomials by the angle in rad."""
    return -DEGREE / np.pi * _bernstein(angles, DEGREE - 1) @ np.diff(-np.eye(DEGREE + 1), axis=0)


def _stretched_and_rotated(array: MicrophoneArray, stretch: float, rotation: float) -> NDArray:
    """Positions (m, 3) stretched about their centre and rotated (rad) counter-clockwise as seen from above."""
    centre = array.positions.mean(axis=0)
    cosine, sine = np.cos(rotation), np.sin(rotation)
    matrix = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return centre + stretch * (array.positions - centre) @ matrix.T
