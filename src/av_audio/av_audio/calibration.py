"""Calibration of a pair of microphones, with a body between them, from a source at known azimuths, and what it is good for.

Consensus finds the curve that most estimates agree with; least squares with a limited loss refine it among those that rise.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.special import comb
from scipy.stats import norm

from av_audio.localizer import DoaEstimate
from av_common.acoustics import BODY_STRETCH
from av_common.angles import wrap
from av_common.microphone_array import DelayCurve, MicrophoneArray

MIN_SPREAD = 1.0    # of the cosines of the angles, of 2 between both ends of the axis
MIRRORED = -0.7    # correlation of cosines and paths: those of exchanged sides explain half of what paths differ by
MIN_CONFIDENCE = 0.9    # as of directions that fusion uses
AGREEMENT = 0.06    # misfit in baselines that agrees; with half of it errors by few estimates are a fifth larger
# Degree of the Bernstein polynomial in the angle to the axis; it falls where its coefficients fall (Farouki, 2012).
DEGREE = 10
MIN_ANGLES = DEGREE    # of estimates that agree: one for each step of the curve
LEAST_STEP = 1e-3    # between two coefficients, in baselines
STIFFNESS = 0.03    # holds terms that the data do not determine; a third or three times as much changes errors by a fifth
OUTLIER = 4.7    # standard deviations; of normal errors three in a million are beyond
LEAST_SCALE = 0.008    # standard deviation in baselines
# Scatter about the curve: largest misfit in baselines that is none of a wrong estimate, and quantile of the misfits.
LARGEST_MISFIT = 0.36
QUANTILE = 0.8
# Places of the source that are left out together, by the angle to the axis, and in how many parts all of them are left out.
PLACE, PARTS = np.radians(10.0), 5
# RMS in deg of the errors at left-out places up to which a calibration is good; within the angle of the axis it may be worse.
GOOD_DEG = 3.0
END_FIRE_DEG = 20.0
# More outliers, a baseline beyond this factor of the nominal one, or a larger rotation contradict the setup.
MOST_OUTLIERS = 0.5
BASELINE_FACTOR = 1.8
LARGEST_ROTATION_DEG = 25.0
WIDEST_GAP_DEG = 40.0    # between angles to the axis that were measured


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


class Verdict(IntEnum):
    """Exit codes of `calibrate`: 1 and 2 are those of errors and of wrong arguments."""

    GOOD = 0
    USABLE = 3
    DO_NOT_USE = 4


class Judgement(NamedTuple):
    """A verdict and its reason in words."""

    verdict: Verdict
    words: str


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


def judge(calibration: Calibration) -> Judgement:
    """What a calibration is good for."""
    complaint = _complaint(calibration)
    if complaint:
        return Judgement(Verdict.DO_NOT_USE, f'do not use: {complaint}')
    angles = np.degrees(calibration.angles[~calibration.outliers])
    residuals = np.degrees(calibration.left_out[~calibration.outliers])
    with_curve, without = (float(np.degrees(np.abs(each).mean())) for each in (calibration.left_out, calibration.before))
    if with_curve >= without:
        return Judgement(Verdict.DO_NOT_USE, f'do not use: places that were left out are heard {with_curve:.1f} deg wrong on '
                                             f'average, {without:.1f} deg without calibration')
    aside = np.abs(angles - 90.0) <= 90.0 - END_FIRE_DEG
    if _rms(residuals[aside]) > GOOD_DEG:
        return Judgement(Verdict.DO_NOT_USE, f'do not use: left-out places are {_rms(residuals[aside]):.1f} deg RMS '
                                             f'wrong, more than {GOOD_DEG:g}; reflections or noise are too strong')
    if _rms(residuals) > GOOD_DEG or angles.min() > END_FIRE_DEG or angles.max() < 180.0 - END_FIRE_DEG:
        return Judgement(Verdict.USABLE, f'usable beyond {END_FIRE_DEG:g} deg from end-fire')
    return Judgement(Verdict.GOOD, 'good')


def outlier_lines(calibration: Calibration, times: NDArray) -> list[str]:
    """A line for each outlier: its time, the true angle to the axis, and the measured one.

    Parameters:
        calibration: the calibration.
        times (n,) (s): times of its estimates.
    """
    return [f'{times[k]:8.2f} s   {np.degrees(calibration.angles[k]):6.1f} deg, heard at '
            f'{np.degrees(calibration.angles[k] + calibration.residuals[k]):6.1f} deg'
            for k in np.flatnonzero(calibration.outliers)]


def _complaint(calibration: Calibration) -> str:
    """What contradicts the setup; empty where nothing does."""
    share = float(np.mean(calibration.outliers))
    factor = calibration.baseline / calibration.nominal
    rotation = float(np.degrees(calibration.axis_offset))
    angles = np.sort(np.degrees(calibration.angles[~calibration.outliers]))
    inside = angles[np.abs(angles - 90.0) < 90.0 - END_FIRE_DEG]
    gaps = np.diff(np.concatenate([[END_FIRE_DEG], inside, [180.0 - END_FIRE_DEG]]))
    widest = int(np.argmax(gaps))
    if share > MOST_OUTLIERS:
        return f'{100.0 * share:.0f} % of the estimates contradict the rest; are times, azimuths and channels right?'
    if not 1.0 / BASELINE_FACTOR < factor < BASELINE_FACTOR:
        return (f'a baseline of {1e3 * calibration.baseline:.0f} mm, where the array file has {1e3 * calibration.nominal:.0f}; '
                'is the array file right?')
    if abs(rotation) > LARGEST_ROTATION_DEG:
        return f'the axis is turned by {rotation:+.0f} deg; are the azimuths counter-clockwise from x of the array?'
    if gaps[widest] > WIDEST_GAP_DEG:
        begin = END_FIRE_DEG if widest == 0 else inside[widest - 1]
        return f'no angles between {begin:.0f} and {begin + gaps[widest]:.0f} deg from the axis'
    return ''


def _rms(values: NDArray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else np.inf


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

    The curve is that of a sphere (Woodworth, 1938) with any ratio of both terms. The loss is limited more and more, so that
    all estimates tell where it begins, and those that agree where it ends (Blake and Zisserman, 1987).

    Parameters:
        azimuths (n,) (rad): true azimuths from the nominal axis.
        paths (n,): path differences in nominal baselines.
    """
    found, most = np.array([0.0, 1.0, 0.0]), np.radians(1.2 * LARGEST_ROTATION_DEG)
    for scale in AGREEMENT * 2.0 ** np.arange(4, -1, -1):
        found = least_squares(
            lambda values, scale=scale: _limited((_terms(np.abs(wrap(azimuths - values[0]))) @ values[1:] - paths) / scale),
            found, bounds=([-most, 0.0, 0.0], [most, np.inf, np.inf])).x
    return float(found[0]), found[1:]


def _fit(azimuths: NDArray, paths: NDArray) -> tuple[NDArray, float, NDArray[np.bool_]]:
    """Bernstein coefficients (DEGREE + 1,) of the path by angle, rotation of the axis, outliers (n,).

    The coefficients fall by at least LEAST_STEP.

    Parameters:
        azimuths (n,) (rad): true azimuths from the nominal axis.
        paths (n,): path differences in nominal baselines.
    """
    offset, weights = _consensus(azimuths, paths)
    grid = np.linspace(0.0, np.pi, 61)
    model = np.linalg.lstsq(_bernstein(grid), _terms(grid) @ weights, rcond=None)[0]
    stiffness = STIFFNESS * np.sqrt(len(paths))

    def misfits(values: NDArray) -> NDArray:
        return _bernstein(np.abs(wrap(azimuths - values[-1]))) @ coefficients(values) - paths

    def errors(values: NDArray, width: float) -> NDArray:
        return np.concatenate([_limited(misfits(values) / width), stiffness / width * np.diff(coefficients(values) - model, 2)])

    def coefficients(values: NDArray) -> NDArray:  # of the first one, the steps down, and the rotation
        return values[0] - np.concatenate([[0.0], np.cumsum(values[1:-1])])

    found, width = np.concatenate([model[:1], np.maximum(-np.diff(model), 2.0 * LEAST_STEP), [offset]]), AGREEMENT
    least = np.concatenate([[-np.inf], np.full(DEGREE, LEAST_STEP), [-np.inf]])
    for _ in range(2):  # the second time as wide as the scatter of the first
        found = least_squares(errors, found, bounds=(least, np.inf), args=(width,)).x
        apart = np.abs(misfits(found))
        near = apart[apart < 2.0 * AGREEMENT]
        if len(near) < MIN_ANGLES:
            raise ValueError(f'{len(near)} of {len(paths)} estimates agree, at least {MIN_ANGLES} are needed')
        width = OUTLIER * max(LEAST_SCALE, 1.4826 * float(np.median(near)))
    return coefficients(found), float(found[-1]), apart > width


def _limited(errors: NDArray) -> NDArray:
    """Errors (n,) whose squares are the loss of Geman and McClure (1987): far estimates do not count."""
    return errors / np.sqrt(1.0 + errors**2)


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
    weights = np.exp(-0.5 * (apart / AGREEMENT) ** 2) + 1.0 / len(paths)  # all others together count as one
    reached = np.cumsum(weights, axis=1) >= QUANTILE * weights.sum(axis=1, keepdims=True)
    return np.maximum(misfits[kept][np.argmax(reached, axis=1)] / norm.ppf(0.5 + 0.5 * QUANTILE), LEAST_SCALE)


def _terms(angles: NDArray) -> NDArray:
    """Cosine (..., 0) and angle from broadside (..., 1) of angles to the axis in rad."""
    return np.stack([np.cos(angles), 0.5 * np.pi - angles], axis=-1)


def _bernstein(angles: NDArray) -> NDArray:
    """Bernstein polynomials (n, DEGREE + 1) at angles (n,) from 0 to pi."""
    share, numbers = np.asarray(angles)[:, None] / np.pi, np.arange(DEGREE + 1)
    return comb(DEGREE, numbers) * share**numbers * (1.0 - share) ** (DEGREE - numbers)


def _stretched_and_rotated(array: MicrophoneArray, stretch: float, rotation: float) -> NDArray:
    """Positions (m, 3) stretched about their centre and rotated (rad) counter-clockwise as seen from above."""
    centre = array.positions.mean(axis=0)
    cosine, sine = np.cos(rotation), np.sin(rotation)
    matrix = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return centre + stretch * (array.positions - centre) @ matrix.T
