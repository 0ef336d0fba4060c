"""From boxes in the image to bearings with variances in the frame of the camera's body."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.camera import PinholeCamera

STEPS = np.array([[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])  # pixels, steps of the numeric Jacobian
# Standard deviations of the centre of a box from that of the target: as a share of the box's side, because large objects are
# located less precisely; of a box of size 0 (pixels); and of the camera's intrinsics and mounting (rad). On clips that the
# shipped detector was not trained on the first two are 0.023 and 0.73. Such errors last for a second: as white noise they have
# three times that variance.
BOX_FRACTION, PIXEL_SIGMA, CALIBRATION_SIGMA = 0.04, 1.26, 0.003
LEAST_SCORE = 0.05  # below it boxes are no less precise


class Bearings(NamedTuple):
    """Bearings in the camera's body frame (x forward, y left, z up).

    Parameters:
        azimuth (n,; rad): counter-clockwise from x.
        elevation (n,; rad): upwards.
        azimuth_variance, elevation_variance (n,) (rad^2): of their errors.
    """

    azimuth: NDArray[np.float64]
    elevation: NDArray[np.float64]
    azimuth_variance: NDArray[np.float64]
    elevation_variance: NDArray[np.float64]


def pixel_variance(sizes: ArrayLike, scores: ArrayLike) -> NDArray[np.float64]:
    """Variances (n, 2) in square pixels of the centres of boxes.

    They are proportional to 1/score, because detections of low score are located less precisely.

    Parameters:
        sizes (n, 2) (pixels): widths and heights.
        scores (n,) (0-1): scores of the detections.
    """
    sizes = np.asarray(sizes, float).reshape(-1, 2)
    scores = np.clip(np.asarray(scores, float).reshape(-1, 1), LEAST_SCORE, 1.0)
    return (PIXEL_SIGMA**2 + (BOX_FRACTION * sizes) ** 2) / scores


def bearings_of_boxes(camera: PinholeCamera, centres: ArrayLike, sizes: ArrayLike, scores: ArrayLike) -> Bearings:
    """Bearings of boxes in the camera's body frame, with first-order error propagation.

    The variance in pixels is multiplied by the numeric Jacobian of the camera model, which includes distortion and the stretch
    of the pinhole towards the edges; the calibration's variance is added. Where a fisheye lens shows nothing, all is nan.

    Parameters:
        camera: intrinsics.
        centres (n, 2) (pixels): centres of the boxes.
        sizes (n, 2; pixels): widths and heights.
        scores (n,) (0-1): scores of the detections.
    """
    centres = np.asarray(centres, float).reshape(-1, 2)
    x, y, z = camera.rays((STEPS[:, None] + centres).reshape(-1, 2)).T
    angles = -np.arctan2([x, y], [z, np.hypot(x, z)]).reshape(2, len(STEPS), -1)
    slopes = angles[:, 1::2] - angles[:, 2::2]  # derivatives of azimuth and elevation by x and y, rad/pixel
    variances = (np.square(slopes) * pixel_variance(sizes, scores).T).sum(axis=1) + CALIBRATION_SIGMA**2
    return Bearings(*angles[:, 0], *variances)
