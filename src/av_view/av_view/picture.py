"""Pictures for viewers: images of any size and depth as small JPEG files."""

from __future__ import annotations

from typing import NamedTuple

import cv2
from numpy.typing import NDArray

from av_vision.image import to_bgr8


class Picture(NamedTuple):
    """A picture for viewers.

    Parameters:
        data: a JPEG file.
        time (s): when it was taken.
        width, height (pixels): its size.
    """

    data: bytes
    time: float
    width: int
    height: int

    @classmethod
    def of(cls, image: NDArray, time: float, most_width: int, quality: int) -> Picture:
        """The picture of an image, reduced where it is wider than `most_width`.

        Parameters:
            image (h, w[, channels]): any image that `to_bgr8` accepts.
            time (s): when it was taken.
            most_width (pixels): largest width.
            quality: 1 to 100.

        Raises ValueError for an array that is no image.
        """
        height, width = image.shape[:2]
        if width > most_width:
            width, height = most_width, max(round(height * most_width / width), 1)
            image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        data = cv2.imencode('.jpg', to_bgr8(image), [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        return cls(data, time, width, height)
