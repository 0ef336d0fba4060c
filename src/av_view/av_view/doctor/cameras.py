"""The camera: whether its pictures come at the rate that was asked for, and whether something can be seen in them.

A square marker that is shown to it tells where it looks, how it is turned, and whether its picture is mirrored (Garrido-Jurado
et al., Automatic generation and detection of highly reliable fiducial markers under occlusion, Pattern Recognition 47(6), 2014;
by OpenCV).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from av_view.doctor.finding import Finding
from av_vision.image import to_bgr8

AREA = 'camera'
LEAST_SHARE = 0.8  # of the rate that was asked for
DARK, BRIGHT = 25.0, 235.0  # mean of 8 bits
BURNT = 0.3  # share of pixels at full scale
STILL = 0.05  # mean difference of pixels between images, below which nothing changes at all: real sensors have noise
NUMBER = 36  # of the marker in its dictionary: its mirror image differs in 10 of 16 squares, of no other marker in more
BORDER = 0.2  # white around the marker, by its side
_DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
_SINCE_4_7 = hasattr(cv2.aruco, 'ArucoDetector')  # Ubuntu 22.04 and 24.04 have OpenCV 4.5 and 4.6


def judge_images(times: Sequence[float], images: Sequence[NDArray], wanted_rate: float, wanted_size: tuple[int, int],
                 ) -> list[Finding]:
    """Judge what a camera has delivered.

    Parameters:
        times (s): capture times, rising.
        images (h, w[, channels]): some of the images.
        wanted_rate (Hz): rate that was asked for; 0 for none.
        wanted_size: width and height (pixels) that were asked for.
    """
    if len(times) < 2 or not images:
        return [Finding(AREA, 'error', 'no images arrive', 'unplug it and plug it in again; is another program using it?')]
    rate = (len(times) - 1) / max(times[-1] - times[0], 1e-9)
    height, width = images[-1].shape[:2]
    found = []
    if rate < LEAST_SHARE * wanted_rate:
        found.append(Finding(AREA, 'warning', f'{rate:.1f} pictures a second come instead of {wanted_rate:.0f}',
                             'more light or a shorter exposure_ms; a smaller width; USB 3 instead of 2'))
    if (width, height) != wanted_size:
        found.append(Finding(AREA, 'warning', f'pictures are {width}x{height} instead of {wanted_size[0]}x{wanted_size[1]}',
                             f'set width and height of camera_node, and of the rig\'s camera, to {width} and {height}'))
    grey = np.stack([to_bgr8(image).mean(axis=2) for image in images])
    level = float(grey.mean())
    if level < DARK:
        found.append(Finding(AREA, 'warning', f'pictures are dark: {level:.0f} of 255', 'the lens cap? raise exposure_ms'))
    if level > BRIGHT or float((grey > 254.0).mean()) > BURNT:
        found.append(Finding(AREA, 'warning', f'pictures are overexposed: mean {level:.0f} of 255', 'lower exposure_ms'))
    if len(grey) > 1 and float(np.abs(np.diff(grey, axis=0)).mean()) < STILL:
        found.append(Finding(AREA, 'warning', 'all pictures are the same', 'is this a camera, or a file or a test pattern?'))
    return found or [Finding(AREA, 'ok', f'{rate:.1f} pictures of {width}x{height} a second')]


class Marker(NamedTuple):
    """The marker in a picture.

    Parameters:
        column, row (pixels): its centre in the picture as it came.
        side (pixels): mean length of its edges.
        roll (rad): by which it is turned clockwise in the picture, or in the mirrored picture where it is found in that alone.
        mirrored: whether it is found in the mirrored picture alone.
    """

    column: float
    row: float
    side: float
    roll: float
    mirrored: bool


def draw_marker(side: int = 800) -> NDArray:
    """The picture (n, n; grey) of a marker of `side` pixels, with white around it."""
    draw = cv2.aruco.generateImageMarker if _SINCE_4_7 else cv2.aruco.drawMarker  # type: ignore[attr-defined]
    return np.pad(draw(_DICTIONARY, NUMBER, side), round(BORDER * side), constant_values=255)


def find_marker(image: NDArray) -> Marker | None:
    """The marker in a picture (height, width) or (height, width, 3) of any depth; None where it is not seen."""
    grey = cv2.cvtColor(to_bgr8(image), cv2.COLOR_BGR2GRAY)
    for mirrored in (False, True):
        corners = _corners(np.ascontiguousarray(grey[:, ::-1]) if mirrored else grey)
        if corners is not None:
            across, side = corners[1] - corners[0], float(np.linalg.norm(np.diff(corners, axis=0), axis=1).mean())
            column, row = corners.mean(axis=0).tolist()
            column = grey.shape[1] - 1.0 - column if mirrored else column
            return Marker(column, row, side, math.atan2(across[1], across[0]), mirrored)
    return None


def _corners(grey: NDArray) -> NDArray | None:
    """Corners (4, 2) of the marker, clockwise from its upper left one."""
    detect = cv2.aruco.ArucoDetector(_DICTIONARY).detectMarkers if _SINCE_4_7 else partial(
        cv2.aruco.detectMarkers, dictionary=_DICTIONARY)
    found, numbers, _ = detect(grey)
    return next((corners[0] for corners, number in zip(found, np.ravel(numbers), strict=True) if number == NUMBER),
                None) if numbers is not None else None
