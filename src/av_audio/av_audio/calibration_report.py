"""What a calibration is good for, in words, as an exit code and as a plot."""

from __future__ import annotations

from enum import IntEnum
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

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
WIDTH, HEIGHT, EDGE = 720, 480, 60    # of the plot in pixels


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


def save_plot(calibration: Calibration, path: str | Path) -> None:
    """Write an SVG image: path differences by the angle to the axis, with the fitted curve; outliers are red.

    Parameters:
        calibration: the calibration.
        path: the file to write.

    Raises OSError.
    """
    curve = calibration.array.delay_curve
    assert curve is not None    # of every calibration
    highest = 1e3 * float(max(np.abs(calibration.paths).max(), calibration.baseline))

    def place(angles: NDArray, paths: NDArray) -> list[str]:
        x = EDGE + (WIDTH - 2 * EDGE) * np.degrees(angles) / 180.0
        y = HEIGHT / 2.0 - (HEIGHT / 2.0 - EDGE) * 1e3 * paths / highest
        return [f'{across:.1f},{down:.1f}' for across, down in zip(x, y, strict=True)]

    grid = np.linspace(0.0, np.pi, 181)
    fitted = ' '.join(place(grid, calibration.baseline * curve.measured_cosine(np.cos(grid))))
    dots = ''.join(
        '<circle cx="{}" cy="{}" r="3" fill="{}"/>\n'.format(*spot.split(','), '#d33' if outlier else '#469')
        for spot, outlier in zip(place(calibration.angles, calibration.paths), calibration.outliers, strict=True))
    ticks = ''.join(f'<text x="{EDGE + (WIDTH - 2 * EDGE) * angle / 180.0:.0f}" y="{HEIGHT - EDGE / 2:.0f}">{angle}</text>\n'
                    for angle in range(0, 181, 30))
    title = escape(f'{calibration.array.name}: {judge(calibration).words}')
    Path(path).expanduser().write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" font-family="sans-serif" font-size="13" '
        f'text-anchor="middle">\n<rect width="100%" height="100%" fill="white"/>\n'
        f'<text x="{WIDTH / 2:.0f}" y="25">{title}</text>\n'
        f'<text x="{WIDTH / 2:.0f}" y="{HEIGHT - 8}">angle to the axis in degrees</text>\n'
        f'<text x="20" y="{HEIGHT / 2:.0f}" transform="rotate(-90 20 {HEIGHT / 2:.0f})">path difference, '
        f'{-highest:.0f} to {highest:.0f} mm</text>\n{ticks}{dots}'
        f'<polyline points="{fitted}" fill="none" stroke="black" stroke-width="1.5"/>\n</svg>\n', encoding='utf-8')


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
