"""How much later the stamps of sound are than those of pictures, from what both said of one moving target.

The cosine of the target's angle from the array's axis is heard at one stamp and seen at another. For each candidate offset the
seen curve is shifted and fitted to the heard one by an affine function (which takes out a turned axis or a wrong baseline); the
offset is where the residual is least: cross-correlation (Knapp and Carter 1976) of two unevenly sampled curves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.angles import wrap

STEP_S = 0.005
GAP_S = 0.3  # what was seen is interpolated across gaps no longer than this
LEAST_PAIRS = 30
LEAST_MOTION = 0.02  # standard deviation of the cosine: a target that hardly moves tells nothing


@dataclass(frozen=True)
class Offset:
    """Seconds by which stamps of sound are later than those of sight, its standard deviation, and the pairs compared."""

    seconds: float
    sigma: float
    pairs: int


def estimate_offset(heard: tuple[ArrayLike, ArrayLike, ArrayLike], seen: tuple[ArrayLike, ArrayLike],
                    largest: float = 0.6) -> Offset:
    """From sounds (times, azimuths of both mirror images) and sightings (times, azimuths), all (n,) in s and rad, body frame.

    Raises ValueError where too little was both heard and seen, or the target hardly moved.
    """
    times, first, second = (np.asarray(column, float) for column in heard)
    at, azimuths = (np.asarray(column, float) for column in seen)
    if len(times) < LEAST_PAIRS or len(at) < LEAST_PAIRS:
        raise ValueError(f'{len(times)} sounds and {len(at)} sightings, at least {LEAST_PAIRS} of each are needed')
    axis = _axis(first, second)
    cosine, shown = np.cos(first - axis), np.cos(azimuths - axis)
    order = np.argsort(at)
    at, shown = at[order], shown[order]
    offsets = np.arange(-largest, largest + 0.5 * STEP_S, STEP_S)
    usable = np.logical_and.reduce([_covered(times - offset, at) for offset in (-largest, 0.0, largest)])
    if usable.sum() < LEAST_PAIRS:
        raise ValueError(f'{usable.sum()} sounds while the target was seen all along, at least {LEAST_PAIRS} are needed')
    times, cosine = times[usable], cosine[usable]
    if np.std(cosine) < LEAST_MOTION:
        raise ValueError('the target hardly moves while it is seen: fly it to and fro before the camera, or turn the rig')
    left = np.array([_residual(cosine, np.interp(times - offset, at, shown)) for offset in offsets])
    best = int(np.clip(np.argmin(left), 1, len(left) - 2))
    curvature = left[best - 1] - 2.0 * left[best] + left[best + 1]
    if curvature <= 0.0 or np.argmin(left) in (0, len(left) - 1):
        raise ValueError(f'no offset within {largest} s fits')
    shift = 0.5 * (left[best - 1] - left[best + 1]) / curvature
    # Windows overlap: about one in five errors is new.
    noise = 5.0 * left[best] / max(len(times) - 2, 1)
    return Offset(float(offsets[best] + shift * STEP_S), float(STEP_S * math.sqrt(2.0 * noise / curvature)), len(times))


def _axis(first: NDArray, second: NDArray) -> float:
    """The array's axis in the body frame, about which the images mirror: the same for all sounds but for its sense."""
    bisector = first + 0.5 * wrap(second - first)
    return float(0.5 * np.angle(np.mean(np.exp(2j * bisector))))


def _covered(times: NDArray, at: NDArray) -> NDArray[np.bool_]:
    """Whether there are sightings close before and after each time."""
    after = np.searchsorted(at, times)
    inside = (after > 0) & (after < len(at))
    after = np.clip(after, 1, len(at) - 1)
    return inside & (at[after] - at[after - 1] <= GAP_S)


def _residual(heard: NDArray, seen: NDArray) -> float:
    """Sum of squares that an affine function of what was seen leaves of what was heard."""
    x, y = seen - seen.mean(), heard - heard.mean()
    power = float(x @ x)
    return float(y @ y) - (float(x @ y) ** 2 / power if power > 0.0 else 0.0)
