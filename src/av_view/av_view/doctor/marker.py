"""A square marker to be shown to a camera: where it is in the picture, how large, how it is turned, and whether it is mirrored.

Garrido-Jurado et al., Automatic generation and detection of highly reliable fiducial markers under occlusion, Pattern
Recognition 47(6), 2014; by OpenCV.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

NUMBER = 36  # of the marker in its dictionary: its mirror image differs in 10 of 16 squares, of no other marker in more
BORDER = 0.2  # white around the marker, by its side
_DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
_SINCE_4_7 = hasattr(cv2.aruco, 'ArucoDetector')  # Ubuntu 22.04 and 24.04 have OpenCV 4.5 and 4.6


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
    """The marker in a picture (height, width) or (height, width, 3) of 8 bits; None where it is not seen."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
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
