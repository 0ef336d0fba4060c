"""Draws detections into images."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from av_vision.detections import Detections
from av_vision.image import to_bgr8

GREEN = (80, 220, 60)  # BGR


def draw(image: NDArray, detections: Detections, tracks: Sequence[int | str]) -> NDArray[np.uint8]:
    """Copy of an image with a box and `class score #track` for each detection.

    Parameters:
        image (h, w[, channels]): any image that `to_bgr8` accepts.
        detections: the detections to draw.
        tracks: track number of each detection.
    """
    canvas = to_bgr8(image).copy()
    rows = zip(np.rint(detections.boxes).astype(int).tolist(), detections.class_names, detections.scores, tracks,
               strict=True)
    for (x1, y1, x2, y2), name, score, track in rows:
        cv2.rectangle(canvas, (x1, y1), (x2, y2), GREEN, 1)
        cv2.putText(canvas, f'{name} {score:.2f} #{track}', (x1, max(y1 - 4, 10)), cv2.FONT_HERSHEY_SIMPLEX, 0.4, GREEN, 1,
                    cv2.LINE_AA)
    return canvas
