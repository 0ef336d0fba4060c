"""From boxes in the image to bearings with variances in the frame of the camera's body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.camera import PinholeCamera

STEPS = np.array([[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])  # pixels, steps of the numeric Jacobian


@dataclass(frozen=True)
class BearingModel:
    """Standard deviations of the centre of a box from the centre of the target. Raises ValueError for negative values.

    The variance in pixels is proportional to 1/score, because detections of low score are located less precisely.

    Parameters:
        box_fraction: standard deviation as a share of the box's side, because large objects are located less precisely.
        pixel_sigma (pixels): standard deviation for a box of size 0.
        calibration_sigma_rad (rad): standard deviation of the camera's intrinsics and mounting.
    """

    box_fraction: float = 0.08
    pixel_sigma: float = 1.0
    calibration_sigma_rad: float = 0.003

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f'{name} is {value}, expected a standard deviation of 0 or more')

    def pixel_variance(self, sizes: ArrayLike, scores: ArrayLike) -> NDArray[np.float64]:
        """Variances (n, 2) in square pixels of the centres of boxes.

        Parameters:
            sizes (n, 2) (pixels): widths and heights.
            scores (n,) (0-1): scores of the detections.
        """
        sizes = np.asarray(sizes, float).reshape(-1, 2)
        scores = np.clip(np.asarray(scores, float).reshape(-1, 1), 0.05, 1.0)
        return (self.pixel_sigma**2 + (self.box_fraction * sizes) ** 2) / scores


@dataclass(frozen=True)
class Bearings:
    """Bearings in the camera's body frame (x forward, y left, z up).

    Parameters:
        azimuth (n,; rad): counter-clockwise from x.
        elevation (n,; rad): upwards.
        azimuth_variance (n,) (rad^2): variance of the azimuth.
        elevation_variance (n,) (rad^2): variance of the elevation.
    """

    azimuth: NDArray[np.float64]
    elevation: NDArray[np.float64]
    azimuth_variance: NDArray[np.float64]
    elevation_variance: NDArray[np.float64]


def bearings_of_boxes(camera: PinholeCamera, centres: ArrayLike, sizes: ArrayLike, scores: ArrayLike,
                      model: BearingModel = BearingModel()) -> Bearings:
    """Bearings of boxes in the camera's body frame, with first-order error propagation.

    The variance in pixels is multiplied by the numeric Jacobian of the camera model, which includes distortion and the stretch
    of the pinhole towards the edges; the calibration's variance is added. Where a fisheye lens shows nothing, all is nan.

    Parameters:
        camera: intrinsics.
        centres (n, 2) (pixels): centres of the boxes.
        sizes (n, 2; pixels): widths and heights.
        scores (n,) (0-1): scores of the detections.
        model: standard deviations of the centres.
    """
    centres = np.asarray(centres, float).reshape(-1, 2)
    x, y, z = camera.rays((STEPS[:, None] + centres).reshape(-1, 2)).T
    angles = -np.arctan2([x, y], [z, np.hypot(x, z)]).reshape(2, len(STEPS), -1)
    slopes = angles[:, 1::2] - angles[:, 2::2]  # derivatives of azimuth and elevation by x and y, rad/pixel
    azimuth_variance, elevation_variance = (
        np.square(slopes) * model.pixel_variance(sizes, scores).T).sum(axis=1) + model.calibration_sigma_rad**2
    return Bearings(angles[0, 0], angles[1, 0], azimuth_variance, elevation_variance)
