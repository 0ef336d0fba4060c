"""Images in files of users: the size in the header is checked before memory is taken for pixels."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from av_common.files import MEGABYTE, check_file
from av_vision.encoded_image import MOST_PIXELS, check_pixels, size_of
from av_vision.sources.capture import SourceError

IMAGE_SUFFIXES = frozenset({'.bmp', '.jpeg', '.jpg', '.pgm', '.png', '.tif', '.tiff', '.webp'})
MOST_BYTES = 1000 * MEGABYTE
_PGM = re.compile(rb'P[25](?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,9})\s')
_WIDTH, _HEIGHT = 256, 257    # tags of TIFF


def read_image(path: Path) -> NDArray:
    """The image (h, w[, channels]) in a file, BGR or grey, in its own depth. Raises SourceError in one line with the path."""
    try:
        data = check_file(path, MOST_BYTES).read_bytes()
        check_pixels(*_size_of(data), MOST_PIXELS)
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
    except OSError as error:
        raise SourceError(str(error)) from error
    except (ValueError, struct.error, cv2.error) as error:
        raise SourceError(f'{path} cannot be read as an image: {getattr(error, "err", None) or error}') from error
    if image is None:
        raise SourceError(f'{path} ({len(data)} bytes) cannot be read as an image')
    return image


def _size_of(data: bytes) -> tuple[int, int]:
    """Width and height in the header of an image. Raises ValueError or struct.error where it has none."""
    if data[:2] == b'BM':
        width, height = struct.unpack_from('<2i', data, 18)
        return abs(width), abs(height)    # negative: from top to bottom
    if data[:4] in (b'II*\0', b'MM\0*'):
        return _size_of_tiff(data, '<' if data[:1] == b'I' else '>')
    if data[:4] == b'RIFF' and data[8:12] == b'WEBP':
        return _size_of_webp(data)
    header = _PGM.match(data[:1000])
    return (int(header[1]), int(header[2])) if header else size_of(data)


def _size_of_tiff(data: bytes, order: str) -> tuple[int, int]:
    first, = struct.unpack_from(f'{order}I', data, 4)
    count, = struct.unpack_from(f'{order}H', data, first)
    found = {}
    for entry in range(first + 2, first + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(f'{order}2H', data, entry)
        if tag in (_WIDTH, _HEIGHT):
            found[tag], = struct.unpack_from(f'{order}{"H" if kind == 3 else "I"}', data, entry + 8)
    if len(found) < 2:
        raise ValueError('a TIFF without a size')
    return found[_WIDTH], found[_HEIGHT]


def _size_of_webp(data: bytes) -> tuple[int, int]:
    kind = data[12:16]
    if kind == b'VP8X':
        return (1 + int.from_bytes(data[24:27], 'little'), 1 + int.from_bytes(data[27:30], 'little'))
    if kind == b'VP8L':
        bits, = struct.unpack_from('<I', data, 21)
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack_from('<2H', data, 26)
    return width & 0x3FFF, height & 0x3FFF
