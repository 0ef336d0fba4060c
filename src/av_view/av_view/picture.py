"""Pictures for viewers: images of any size and depth as small JPEG files."""

from __future__ import annotations

import cv2
from numpy.typing import NDArray

from av_vision.image import to_bgr8


def jpeg(image: NDArray, width: int, quality: int) -> bytes:
    """A JPEG file of an image, reduced where it is wider than `width`.

    Parameters:
        image (h, w[, channels]): any image that `to_bgr8` accepts.
        width (pixels): largest width.
        quality: 1 to 100.

    Raises ValueError for an array that is no image.
    """
    if image.ndim >= 2 and image.shape[1] > width:
        height = max(round(image.shape[0] * width / image.shape[1]), 1)
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return cv2.imencode('.jpg', to_bgr8(image), [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
