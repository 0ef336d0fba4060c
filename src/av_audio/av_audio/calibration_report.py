"""What a calibration is good for, in words and as an exit code."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_audio.calibration import Calibration

# RMS in deg of the errors at left-out places up to which a calibration is good; within the angle of the axis it may be worse.
GOOD_DEG = 3.0
END_FIRE_DEG = 20.0
# More outliers, a baseline beyond this factor of the nominal one, or a larger rotation contradict the setup.
MOST_OUTLIERS = 0.5
BASELINE_FACTOR = 1.8
LARGEST_ROTATION_DEG = 25.0
WIDEST_GAP_DEG = 40.0    # between angles to the axis that were measured


class Verdict(IntEnum):
    """Exit codes of `calibrate`: 1 and 2 are those of errors and of wrong arguments."""

    GOOD = 0
    USABLE = 3
    DO_NOT_USE = 4


class Judgement(NamedTuple):
    """A verdict and its reason in words."""

    verdict: Verdict
    words: str


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
