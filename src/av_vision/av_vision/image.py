"""Conversion of images of any depth to the 8-bit BGR images of a detector."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def to_bgr8(image: NDArray) -> NDArray[np.uint8]:
    """Convert an image to (h, w, 3) BGR of 8 bits; other depths are scaled from their 1st to their 99th percentile.

    Raises ValueError for an empty array and for a shape other than (h, w) or (h, w, 1|3|4).
    """
    if image.size == 0 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3, 4)):
        raise ValueError(f'an array of shape {image.shape} is no image, expected (h, w) or (h, w, 1|3|4)')
    if image.dtype != np.uint8:
        finite = np.nan_to_num(image.astype(np.float32))
        low, high = np.percentile(finite[::4, ::4], (1.0, 99.0))
        image = np.clip((finite - low) * (255.0 / max(high - low, 1e-9)), 0, 255).astype(np.uint8)
    if image.ndim == 2 or image.shape[2] == 1:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGRA2BGR) if image.shape[2] == 4 else image, np.uint8)
