"""Pictures for viewers: images of any size and depth as small JPEG files, once their detections have come."""

from __future__ import annotations

import struct

import cv2
from numpy.typing import NDArray

from av_vision.image import to_bgr8

LONGEST_NS, MOST_BYTES = 1_500_000_000, 64 << 20  # of the images that wait for their detections
WIDTH, QUALITY = 640, 70  # pixels, to which larger pictures are reduced; of JPEG
STAMP = struct.Struct('<iI')  # of a header, after the encapsulation: the first field of an image


class RecentImages(dict[int, bytes]):
    """Serialised images of the last moments by their stamps (ns), since detections come later than their image."""

    def __init__(self) -> None:
        super().__init__()
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
        self[self.newest] = data
        excess = sum(map(len, self.values())) - MOST_BYTES
        for stamp in sorted(self):
            if stamp != self.newest and (excess > 0 or abs(self.newest - stamp) > LONGEST_NS):
                excess -= len(self.pop(stamp))


def jpeg_of(image: NDArray) -> bytes:
    """A JPEG file of an image (h, w[, channels]), reduced to WIDTH. Raises ValueError for an array that is no image."""
    height, width = image.shape[:2]
    if width > WIDTH:
        image = cv2.resize(image, (WIDTH, max(round(height * WIDTH / width), 1)), interpolation=cv2.INTER_AREA)
    return cv2.imencode('.jpg', to_bgr8(image), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()
