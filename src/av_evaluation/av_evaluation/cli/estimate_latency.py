"""ros2 run av_evaluation estimate_latency BAG: offset between the stamps of sound and of images in a bag.

The cosine of the target's angle from the array's axis is measured acoustically and seen by the camera. For each candidate
offset the seen curve is shifted and fitted to the measured one by an affine function, which removes a rotated axis or a wrong
baseline. The offset has the least residual: cross-correlation (Knapp and Carter 1976) of two unevenly sampled curves.
"""

from __future__ import annotations

import argparse
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_bags.reader import Bag
from av_common.angles import wrap
from av_evaluation.metrics.metrics import TAU
from av_evaluation.replay.replay import Replay, ReplaySettings
from av_evaluation.runs.program import run_program

LARGEST_S = 0.6  # of offsets: more than any sensor's delay that was met, less than a second, which has aliases
STEP_S = 0.005  # between candidates; a parabola interpolates
GAP_S = 0.3  # longest gap between detections that is interpolated
LEAST_PAIRS = 30  # of which six are independent, as windows overlap
LEAST_MOTION = 0.02  # standard deviation of the cosine, below which the motion is too small


def main(arguments: list[str] | None = None) -> int:
    """Print the offset and the parameter that compensates it; returns 1 where it cannot be estimated."""
    parser = argparse.ArgumentParser(prog='estimate_latency', description=__doc__)
    parser.add_argument('bag', help='mcap or sqlite3 (.db3), a file or a folder')
    return run_program(_estimate, parser, arguments, refused=1)


def _estimate(options: argparse.Namespace) -> int:
    with Bag(options.bag) as bag:
        log = Replay(bag, ReplaySettings()).run()
    sound, sight = log.sound['confidence'] >= 0.5, log.sight['score'] >= TAU
    offset = estimate_offset((log.sound['time'][sound], log.sound['azimuth'][sound], log.sound['mirrored'][sound]),
                             (log.sight['time'][sight], log.sight['azimuth'][sight]))
    print(f'stamps of sound are {1e3 * offset.seconds:+.1f} ms (+-{1e3 * offset.sigma:.1f}) later than those of sight, '
          f'from {offset.pairs} pairs\nfusion_node: sound_delay: {offset.seconds:.3f}   (to be added to the present value)')
    return 0


class Offset(NamedTuple):
    """An estimated offset.

    Parameters:
        seconds (s): delay of the stamps of directions of arrival relative to those of images.
        sigma (s): its standard deviation.
        pairs: number of directions of arrival compared.
    """

    seconds: float
    sigma: float
    pairs: int


def estimate_offset(directions: tuple[ArrayLike, ArrayLike, ArrayLike], sightings: tuple[ArrayLike, ArrayLike]) -> Offset:
    """Estimate the offset from directions of arrival and sightings of one target.

    Parameters:
        directions: times (n; s) and azimuths of both mirror images (n; rad) in the body frame, NaN without a second one.
        sightings: times (k; s) and azimuths (k; rad) in the body frame.

    Raises ValueError for too few simultaneous measurements, and for a target that hardly moves.
    """
    times, first, second = (np.asarray(column, float) for column in directions)
    at, azimuths = (np.asarray(column, float) for column in sightings)
    if len(times) < LEAST_PAIRS or len(at) < LEAST_PAIRS:
        raise ValueError(f'{len(times)} directions of arrival and {len(at)} sightings: at least {LEAST_PAIRS} of each needed')
    axis = _axis(first, np.where(np.isnan(second), math.pi - first, second))    # without images any axis does
    cosine, seen_cosine = np.cos(first - axis), np.cos(azimuths - axis)
    order = np.argsort(at)
    at, seen_cosine = at[order], seen_cosine[order]
    offsets = np.arange(-LARGEST_S, LARGEST_S + 0.5 * STEP_S, STEP_S)
    usable = np.logical_and.reduce([_covered(times - offset, at) for offset in (-LARGEST_S, 0.0, LARGEST_S)])
    if usable.sum() < LEAST_PAIRS:
        raise ValueError(f'{usable.sum()} directions of arrival with the target in view: at least {LEAST_PAIRS} needed')
    times, cosine = times[usable], cosine[usable]
    if np.std(cosine) < LEAST_MOTION:
        raise ValueError('the target hardly moves while it is seen: move it through the field of view, or rotate the rig')
    left = np.array([_residual(cosine, np.interp(times - offset, at, seen_cosine)) for offset in offsets])
    best = int(np.clip(np.argmin(left), 1, len(left) - 2))
    curvature = left[best - 1] - 2.0 * left[best] + left[best + 1]
    if curvature <= 0.0 or np.argmin(left) in (0, len(left) - 1):
        raise ValueError(f'no offset within {LARGEST_S} s fits')
    shift = 0.5 * (left[best - 1] - left[best + 1]) / curvature
    # Windows overlap: about one in five errors is independent.
    noise = 5.0 * left[best] / max(len(times) - 2, 1)
    return Offset(float(offsets[best] + shift * STEP_S), float(STEP_S * math.sqrt(2.0 * noise / curvature)), len(times))


def _axis(first: NDArray, second: NDArray) -> float:
    """Azimuth (rad) of the array's axis in the body frame, about which the images are mirrored; its sign is arbitrary."""
    bisector = first + 0.5 * wrap(second - first)
    return float(0.5 * np.angle(np.mean(np.exp(2j * bisector))))


def _covered(times: NDArray, at: NDArray) -> NDArray[np.bool_]:
    """Whether each time lies between two sightings that are at most GAP_S apart."""
    after = np.searchsorted(at, times)
    inside = (after > 0) & (after < len(at))
    after = np.clip(after, 1, len(at) - 1)
    return inside & (at[after] - at[after - 1] <= GAP_S)


def _residual(directions: NDArray, sightings: NDArray) -> float:
    """Residual sum of squares of an affine fit of the measured curve by the seen one."""
    x, y = sightings - sightings.mean(), directions - directions.mean()
    power = float(x @ x)
    return float(y @ y) - (float(x @ y) ** 2 / power if power > 0.0 else 0.0)
