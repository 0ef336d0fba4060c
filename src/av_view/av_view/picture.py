"""Pictures for viewers: images of any size and depth as small JPEG files, each with the detections that were made in it."""

from __future__ import annotations

import struct
from typing import NamedTuple

import cv2
from numpy.typing import NDArray

from av_vision.image import to_bgr8

LONGEST_NS, MOST_BYTES = 1_500_000_000, 64 << 20  # of the images that wait for their detections
STAMP = struct.Struct('<iI')  # of a header, after the encapsulation: the first field of an image


class RecentImages:
    """Serialised images of the last moments by their stamps, since detections come later than their image."""

    def __init__(self) -> None:
        self._images: dict[int, bytes] = {}
        self.newest = 0

    def add(self, data: bytes) -> None:
        """Keep a serialised image. Raises ValueError for bytes that are none.

        Parameters:
            data: little-endian CDR.
        """
        if len(data) < 4 + STAMP.size or not data[1] & 1:
            raise ValueError(f'{len(data)} bytes, expected an image')
        seconds, nanoseconds = STAMP.unpack_from(data, 4)
        self.newest = seconds * 1_000_000_000 + nanoseconds
        self._images[self.newest] = data
        self._images = {stamp: kept for stamp, kept in self._images.items() if abs(self.newest - stamp) <= LONGEST_NS}
        excess = sum(map(len, self._images.values())) - MOST_BYTES
        for stamp in sorted(self._images):
            if excess > 0 and stamp != self.newest:
                excess -= len(self._images.pop(stamp))

    def get(self, stamp: int) -> bytes | None:
        """The image of a stamp (ns); None where it is not there."""
        return self._images.get(stamp)


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
