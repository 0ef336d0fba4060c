"""Decoding of JPEG and PNG files of untrusted origin: the size in the header is checked before memory is taken for pixels."""

from __future__ import annotations

import re
import struct

import cv2
import numpy as np
from numpy.typing import NDArray

MOST_PIXELS = 100_000_000    # limit where nothing knows the camera
MOST_SCANS = 32              # of a JPEG; a progressive one has about ten, and each takes time for the whole image
MOST_SEGMENTS = 256          # before the size in a JPEG
MOST_SIDE = 16_384           # pixels of width or height
_MARKER = re.compile(rb'\xff([^\xff])', re.DOTALL)
_PNG = b'\x89PNG\r\n\x1a\n'
_JPEG = b'\xff\xd8'
_IHDR = struct.Struct('>I4s2I')
_SIZES = frozenset({0xC0, 0xC1, 0xC2})    # baseline, extended and progressive Huffman coding
_OTHER_SIZES = frozenset(range(0xC3, 0xD0)) - {0xC4, 0xC8, 0xCC}    # lossless, hierarchical, arithmetic coding
_BARE = frozenset({0x01, *range(0xD0, 0xD8)})    # markers without a segment


def decode_image(data: bytes | memoryview, flags: int, most_pixels: int = MOST_PIXELS) -> NDArray:
    """The image (h, w[, channels]) in a JPEG or PNG file. Raises ValueError if it is neither, damaged or too large.

    Parameters:
        data: content of the file.
        flags: OpenCV's IMREAD flags.
        most_pixels: maximum number of pixels.
    """
    check_pixels(*size_of(data), most_pixels)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise ValueError(f'image of {len(data)} bytes cannot be decoded: {error.err}') from error
    if image is None:
        raise ValueError(f'image of {len(data)} bytes cannot be decoded')
    return image


def check_pixels(width: int, height: int, most: int) -> None:
    """Raise ValueError for a size that is empty or too large.

    Parameters:
        width, height (pixels): size of an image.
        most: maximum number of pixels.
    """
    if not (0 < width * height <= most and max(width, height) <= MOST_SIDE):
        raise ValueError(f'image of {width}x{height} pixels, expected 1 to {most} pixels, and at most '
                         f'{MOST_SIDE} in width and height')


def size_of(data: bytes | memoryview) -> tuple[int, int]:
    """Width and height in the header of a JPEG or PNG file. Raises ValueError if it has none."""
    data = bytes(data)
    size = _size_of_png(data) if data.startswith(_PNG) else _size_of_jpeg(data) if data.startswith(_JPEG) else None
    if size is None:
        raise ValueError(f'image of {len(data)} bytes cannot be decoded: expected a complete header of JPEG or PNG')
    return size


def _size_of_png(data: bytes) -> tuple[int, int] | None:
    if len(data) < len(_PNG) + _IHDR.size:
        return None
    length, kind, width, height = _IHDR.unpack_from(data, len(_PNG))
    return (width, height) if (length, kind) == (13, b'IHDR') else None


def _size_of_jpeg(data: bytes) -> tuple[int, int] | None:
    """The size in the first frame header, found as libjpeg finds it: bytes between segments are skipped."""
    if data.count(b'\xff\xda') > MOST_SCANS:
        raise ValueError(f'image: a JPEG of more than {MOST_SCANS} scans')
    position = len(_JPEG)
    for _ in range(MOST_SEGMENTS):
        found = _MARKER.search(data, position)
        if found is None or found.end() + 7 > len(data):
            return None
        marker, position = found[1][0], found.end()
        if marker in _SIZES:
            height, width = struct.unpack_from('>2H', data, position + 3)
            return width, height
        if marker in _OTHER_SIZES or marker in (0xD9, 0xDA):
            return None
        if marker and marker not in _BARE:
            position += max(struct.unpack_from('>H', data, position)[0], 2)
    return None
