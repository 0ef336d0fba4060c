"""Meteorological visibility in an image, by which fusion weights missing detections.

In homogeneous air of extinction b (1/m) an object of radiance J at distance d appears as J e^(-bd) + A (1 - e^(-bd)), with A
the light scattered into the view (Koschmieder 1924); a target's contrast falls as e^(-bd) (Beer-Lambert), to 5 % at ln(20)/b.
Where distances are known (a depth image, or the height of the camera over flat ground) b follows from the decrease of
contrast with distance; without a scale only the share of contrast that is left in the whole image can be estimated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from av_common.camera import PinholeCamera
from av_vision.image import NORMAL_MAD, noise_of, to_bgr8

LEFT_AT_RANGE = 0.05  # share of the contrast, by definition of the meteorological range (WMO No. 8)
BINS = 16  # number of bins of distance, of as many pixels each
QUANTILES = (0.05, 0.2, 0.5, 0.8)  # quantiles of brightness in a bin; the brightest objects may be lamps or walls
USUAL = 0.05  # extinction in 1/m with which the fit begins
ANCHOR = 1.0  # weight of the sky's brightness as air light, per grey level
USUAL_CONTRAST = 40.0  # grey levels between the dark and the bright parts of a scene: a uniform image is fog, not paint
SMALL = (160, 120)  # pixels, to which an image is reduced where details say nothing
BLACK = 16.0  # grey level of black in video (ITU-R BT.601)
AREA = 7  # pixels of a small image: side of the smallest area that is black rather than a shadow
NORMAL_SPREAD = 3.7  # standard deviations between the percentiles 2 and 95 of normal noise
LEAST_PIXELS = 30  # of a bin: their median errs by 0.23 of their standard deviation
DENSEST, CLEAREST = 3.0, 1e-4  # extinction in 1/m that can be estimated
LONGEST = 640, 160  # pixels, to which the longer side is reduced, for blur and, where that tells nothing, for strong blur
STEP = 15  # pixels, in which a step has its height
FEWEST = 200  # pixels beside steps that tell
# Slopes of the steepest steps, 1/pixel: in 61 clips and 24 rendered pictures they have 0.39 to 0.9. Blurred to 0.2 and 0.17 the
# shipped detector finds 0.4 and 0.2 of what it finds in sharp ones, at 0.11 nothing.
BLURRED, SHARP = 0.12, 0.35


@dataclass(frozen=True)
class Visibility:
    """Remaining contrast and extinction.

    Parameters:
        share (0-1): share of a target's contrast that reaches the camera from the given distance.
        extinction (1/m): extinction of the air; nan where it cannot be estimated.
        sharp (0-1): see `sharpness`.
    """

    share: float
    extinction: float = math.nan
    sharp: float = 1.0

    @property
    def range(self) -> float:
        """Meteorological range in m, where 5 % of the contrast are left; nan where it cannot be estimated."""
        return -math.log(LEFT_AT_RANGE) / self.extinction


def ground_distances(camera: PinholeCamera, height: float, rotation: NDArray) -> NDArray[np.float32]:
    """Distances (h, w) in m to flat ground; inf at and above the horizon.

    Parameters:
        camera: intrinsics.
        height (m): height of the camera over the ground.
        rotation (3, 3): rotation matrix from the optical frame to a level frame with z up.
    """
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    down = -(camera.rays(np.stack([columns, rows], -1).reshape(-1, 2)) @ np.asarray(rotation).T)[:, 2]
    distance = np.where(down > 1e-3, height / np.maximum(down, 1e-3), np.inf)
    return distance.reshape(camera.height, camera.width).astype(np.float32)


def estimate(image: NDArray, distance: NDArray | None = None, target_distance: float = 10.0) -> Visibility:
    """Visibility in an image.

    Parameters:
        image (h, w[, 3]): image of any depth.
        distance (h, w; m): distance of the surface in each pixel, nan or 0 if unknown, inf for the sky; None without a scale.
        target_distance (m): distance of the target whose share of contrast is estimated.
    """
    grey = cv2.cvtColor(to_bgr8(image), cv2.COLOR_BGR2GRAY).astype(np.float32)
    if distance is None:
        return Visibility(contrast_left(grey), sharp=sharpness(grey))
    extinction = fit_extinction(grey, np.where(unlit(grey), np.nan, np.asarray(distance, np.float32)))
    left = math.exp(-extinction * target_distance) if math.isfinite(extinction) else math.nan
    return Visibility(left, extinction, sharpness(grey))


def fit_extinction(grey: NDArray[np.float32], distance: NDArray[np.float32]) -> float:
    """Extinction in 1/m from brightness (h, w) against distance (h, w) in m; nan where too few distances are in view.

    Each quantile of brightness follows A + (J - A) e^(-bd) over bins of distance, with its own J and common A and b, fitted
    with a robust loss.

    Parameters:
        grey (h, w): brightness, 0..255.
        distance (h, w; m): distance of the surface in each pixel, nan or 0 if unknown, inf for the sky.
    """
    near = np.isfinite(distance) & (distance > 0.3)
    if near.sum() < BINS * LEAST_PIXELS:
        return math.nan
    away, brightness = distance[near], grey[near]
    bins = np.array_split(np.argsort(away, kind='stable'), BINS)
    at = np.array([np.median(away[part]) for part in bins])
    if at[-1] < 1.5 * at[0]:
        return math.nan
    levels = np.array([np.quantile(brightness[part], QUANTILES) for part in bins])
    sky = grey[np.isinf(distance)]
    return _fit(at, levels, float(np.median(sky)) if sky.size >= LEAST_PIXELS else None)


def _fit(at: NDArray, levels: NDArray, sky: float | None) -> float:
    """Least squares for log extinction, air light and radiances over distances (n,) and quantiles (n, q)."""
    air = sky if sky is not None else float(levels[-1].mean())

    def residuals(x: NDArray) -> NDArray:
        left = np.exp(-np.exp(x[0]) * at)[:, None]
        model = x[1] + (x[2:] - x[1]) * left
        anchor = ANCHOR * (x[1] - air)
        plain = max(USUAL_CONTRAST - (x[-1] - x[2]), 0.0) / USUAL_CONTRAST
        return np.concatenate([((model - levels) / 4.0).ravel(), [anchor, 8.0 * plain]])

    bounds = (np.r_[math.log(CLEAREST), 0.0, [-40.0] * levels.shape[1]],
              np.r_[math.log(DENSEST), 255.0, [295.0] * levels.shape[1]])
    guess = np.clip(np.r_[math.log(USUAL), air, levels[0]], *bounds)
    return float(np.exp(least_squares(residuals, guess, bounds=bounds, loss='soft_l1').x[0]))


def contrast_left(grey: NDArray[np.float32]) -> float:
    """Clearness of an image, 0-1, without scale: the difference between its darkest parts and the light of the air.

    The dark-channel prior (He, Sun, Tang 2009) on brightness: in clear air some part of the view is dark. Noise is no contrast,
    and less than that of a usual scene is too little: at night nothing is seen, however clear the air.
    """
    small = np.asarray(cv2.resize(grey, SMALL, interpolation=cv2.INTER_AREA), np.float32)
    lit = small[~unlit(small)]
    if lit.size < LEAST_PIXELS:
        return 0.0
    air, dark = np.percentile(lit, [95.0, 2.0])
    contrast = air - dark - NORMAL_SPREAD * noise_of(small)
    return float(np.clip(contrast / max(0.85 * air, USUAL_CONTRAST), 0.0, 1.0))


def sharpness(grey: NDArray[np.float32]) -> float:
    """Share (0-1) of what is found in sharp images that is found in this one (h, w), by its blur; 1 where nothing tells.

    A step behind a blur of sigma pixels has a slope of 1 / (sigma sqrt(2 pi)) of its height at most. So the steepest slopes
    tell the blur of focus, of water on the lens and, along rows or columns, of motion, whatever the scene is.
    """
    for longest in LONGEST:
        scale = min(longest / max(grey.shape), 1.0)
        small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        slopes = [steepest(part) for part in (small, np.ascontiguousarray(small.T))]
        if not np.isnan(slopes).all():
            return float(np.clip((np.nanmin(slopes) - BLURRED) / (SHARP - BLURRED), 0.0, 1.0))
    return 1.0


def steepest(grey: NDArray) -> float:
    """The steepest slopes along the rows (h, w), as shares of the height of their step for each pixel; nan of too few steps."""
    slopes, row = np.abs(np.diff(grey, axis=1)), np.ones((1, STEP), np.uint8)
    noise = NORMAL_MAD * float(np.median(slopes)) if slopes.size else 0.0
    heights = (cv2.dilate(grey, row) - cv2.erode(grey, row))[:, 1:]
    steps = heights >= max(USUAL_CONTRAST, 8.0 * noise)
    if steps.sum() < FEWEST:
        return math.nan
    return float(np.percentile(np.maximum(slopes - 2.0 * noise, 0.0)[steps] / heights[steps], 99.0))


def unlit(grey: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Where an image (h, w) shows nothing: bars, what is beside the round picture of a lens, and their soft edges."""
    small = cv2.resize(grey, SMALL, interpolation=cv2.INTER_AREA)
    square = np.ones((AREA, AREA), np.uint8)
    black = np.pad((small < BLACK).astype(np.uint8), AREA, constant_values=1)    # slivers at the edges are areas, too
    areas = cv2.dilate(cv2.morphologyEx(black, cv2.MORPH_OPEN, square)[AREA:-AREA, AREA:-AREA], square)
    return np.asarray(cv2.resize(areas, grey.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0)
