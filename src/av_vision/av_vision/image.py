"""Decoding of JPEG and PNG files of untrusted origin, and conversion of any depth to the 8-bit BGR images of a detector.

The size in a file's header, and those of a PNG's chunks, are checked before memory is taken for them.
"""

from __future__ import annotations

import math
import re
import struct

import cv2
import numpy as np
from numpy.typing import NDArray

LOW, HIGH = 1.0, 99.0  # percentiles that become black and white
GAIN_S = 1.0           # time constant with which they follow the scene: below the rate at which flicker disturbs a detector
SURROUNDINGS = 1 / 12  # widths: range of the local mean of heat
COARSE = 8             # pixels of a step in which the local mean is made
LEVELS = 3             # of counts for which it is made: cold, between, hot
RARE = 0.3             # share of the surroundings that an object fills: 50 of 320 pixels, the largest that the detector knows
LEAST_NOISES = 20.0    # standard deviations of the noise that the range holds: a plain sky is shown as grey, not as noise
STUCK = 20              # images in which a pixel has one count, of a sensor whose noise changes at least half of them each time
FILLED = 9              # pixels: side of the square whose good pixels take the place of a bad one
MOST_BAD = 0.05         # share of bad pixels: sold sensors have below 0.01, and some rows; more are a scene below the range
NORMAL_MAD = 1.4826    # standard deviation of normal values over their median absolute deviation
MOST_PIXELS = 100_000_000    # limit where nothing knows the camera
MOST_SCANS = 32              # of a JPEG; a progressive one has about ten, and each takes time for the whole image
MOST_SEGMENTS = 256          # before the size in a JPEG; OpenCV takes 4 us for each
MOST_CHUNKS = 100_000        # of a PNG; those of MOST_PIXELS have some thousand bytes each
MOST_SIDE = 16_384           # pixels of width or height
_MARKER = re.compile(rb'\xff([^\xff])', re.DOTALL)
PNG = b'\x89PNG\r\n\x1a\n'
JPEG = b'\xff\xd8'
_CHUNK, _SIDES = struct.Struct('>I4s'), struct.Struct('>2I')    # length and kind, before content and checksum; in the first
_SIZES = frozenset({0xC0, 0xC1, 0xC2})    # baseline, extended and progressive Huffman coding
_OTHER_SIZES = frozenset(range(0xC3, 0xD0)) - {0xC4, 0xC8, 0xCC}    # lossless, hierarchical, arithmetic coding
_BARE = frozenset({0x01, *range(0xD0, 0xD8)})    # markers without a segment


class AutomaticGain:
    """Maps raw counts of a sensor, such as those of a thermal camera, to 8 bits with a range that follows the scene slowly.

    What moves both ends of the counts alike is the sensor, such as its flat-field correction, and is followed at once.

    Parameters:
        heat: whether counts are of heat. Then the local mean is taken out, as thermal cameras do in pictures of their own: sky,
            ground and roofs differ by far more than what is in them.
    """

    def __init__(self, heat: bool = False) -> None:
        self._heat = heat
        self._bad = BadPixels()
        self._range, self._ends = np.zeros(2), np.zeros(2)  # black, and the logarithm of the span; percentiles
        self._time, self._shape = -math.inf, (0, 0)

    def apply(self, image: NDArray, time: float) -> NDArray[np.uint8]:
        """The image in 8 bits; one that has 8 bits is returned as it is.

        Parameters:
            image (h, w[, channels]): raw counts; values that are not finite count as 0.
            time (s): capture time; after an earlier one, for another size, and when stuck pixels are found, the range begins
                anew.
        """
        if image.dtype == np.uint8:
            return image
        counts = np.nan_to_num(image.astype(np.float32), posinf=0.0, neginf=0.0)
        counts = self._bad.filled(counts) if self._heat else counts
        good = usable(counts[::4, ::4])
        if self._heat:
            low, high = np.percentile(counts[::4, ::4][good], (LOW, HIGH))
            counts = counts - local_mean(counts.clip(low, high))
        ends = np.asarray(np.percentile(counts[::4, ::4][good], (LOW, HIGH)), float)
        newest = range_of(ends, noise_of(counts[::4], step_of(image[::4])))
        if self._bad.found or image.shape[:2] != self._shape or time < self._time:
            self._range, self._shape = newest, image.shape[:2]
        else:
            self._range[0] += common(*(ends - self._ends))
            self._range = between(self._range, newest, 1.0 - math.exp((self._time - time) / GAIN_S))
        self._time, self._ends = time, ends
        black, log_span = self._range
        return np.clip((counts - black) * (255.0 / math.exp(log_span)), 0, 255).astype(np.uint8)


class BadPixels:
    """Fills pixels that tell nothing by their neighbours: dead ones, and stuck ones, whose count noise does not change.

    Thermal sensors have some of both, and rows or columns of them; in pictures of their own cameras replace them, too.

    Attributes:
        found: whether the last image showed that more than one in a thousand are stuck.
    """

    def __init__(self) -> None:
        self.found = False
        self._last = self._same = np.empty((0, 0), np.float32)    # counts; number of images in which they were the same

    def filled(self, counts: NDArray[np.float32]) -> NDArray[np.float32]:
        """Counts (h, w[, channels]) without bad pixels, as far as good ones are near."""
        if self._last.shape != counts.shape:
            self._last, self._same = np.full_like(counts, np.nan), np.zeros_like(counts)
        same = counts == self._last
        if same.mean() < 0.5:    # else a repeated image, or steps above the noise
            self._same = (self._same + 1.0) * same
        self._last, self.found = counts, bool((self._same == STUCK).mean() > 1e-3)
        bad, stuck = counts == 0.0, self._same >= STUCK
        if stuck.any():
            top = (counts == counts.max()).astype(np.uint8)
            things = cv2.morphologyEx(top, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8)) > 0    # hotter than the range
            bad |= stuck & ~saturated(counts) & ~things
        if not 0.0 < bad.mean() < MOST_BAD:
            return counts
        weights = (~bad).astype(np.float32)
        near, share = (cv2.blur(values, (FILLED, FILLED)) for values in (weights * counts, weights))
        return np.asarray(np.where(bad & (share > 0.5 / FILLED**2), near / np.maximum(share, 1e-6), counts), np.float32)


def between(old: NDArray[np.float64], new: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """A range part of the way from an old to a new one (see `range_of`): what is as grey in both stays so on the way."""
    black, log_span = new - old
    moved = math.expm1(share * log_span) / math.expm1(log_span) if log_span else share
    return old + np.array([moved * black, share * log_span])


def common(low: float, high: float) -> float:
    """What two moves have in common: all of equal ones, nothing if one is twice the other or they are opposite."""
    nearer, farther = sorted((abs(low), abs(high)))
    return math.copysign(max(2.0 * nearer - farther, 0.0), low) if low * high > 0.0 else 0.0


def usable(counts: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which of some pixels are neither dead, of count 0, nor saturated; all of them if none is."""
    good = (counts != 0) & ~saturated(counts)
    return np.asarray(good | ~good.any())


def saturated(counts: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which pixels have the largest count of a converter: all its bits are ones, those below the last one aside."""
    top = int(counts.max())
    return np.asarray((counts == top) & (top > 0 and (top // (top & -top) + 1).bit_count() == 1))


def local_mean(counts: NDArray[np.float32]) -> NDArray[np.float32]:
    """The mean of what surrounds each pixel of an image (h, w[, channels]) and is about as warm: a roof does not warm the sky.

    A bilateral filter, piecewise linear between LEVELS counts (Durand and Dorsey 2002; of heat: Branchitta et al. 2009). Where
    less than RARE is about as warm, the mean of all counts.
    """
    low, high = float(counts.min()), float(counts.max())
    levels = (counts - low) * ((LEVELS - 1) / max(high - low, 1e-9))
    of_all, found = coarse_mean(counts), np.zeros_like(counts)
    for level in range(LEVELS):
        share = (1.0 - np.abs(levels - level)).clip(0.0)
        alike = (coarse_mean(share * counts) + RARE * of_all) / (coarse_mean(share) + RARE)
        found += share * cv2.resize(alike, counts.shape[1::-1], interpolation=cv2.INTER_LINEAR).reshape(counts.shape)
    return found


def coarse_mean(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """The mean of what surrounds each cell of COARSE pixels of an image (h, w[, channels]), with normal weights."""
    height, width = values.shape[:2]
    small = cv2.resize(values, (max(width // COARSE, 1), max(height // COARSE, 1)), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small, (0, 0), SURROUNDINGS * small.shape[1]), np.float32)


def noise_of(counts: NDArray[np.float32], step: int = 0) -> float:
    """Standard deviation of the noise of some rows (h, w[, channels]) of an image, whose counts are multiples of a step."""
    # Neighbours see almost the same: half of their differences are smaller than the median, which is known to half a step.
    median = float(np.median(np.abs(np.diff(counts, axis=1)))) if counts.shape[1] > 1 else 0.0
    return NORMAL_MAD * max(median, 0.5 * step) / math.sqrt(2.0)


def step_of(image: NDArray) -> int:
    """The largest power of two of which all counts of an image are multiples; 0 for counts that are not whole."""
    bits = int(np.bitwise_or.reduce(image, axis=None)) if np.issubdtype(image.dtype, np.integer) else 0
    return bits & -bits


def range_of(ends: NDArray[np.float64], noise: float) -> NDArray[np.float64]:
    """Black, and the logarithm of the span from black to white, in counts, of percentiles (2,) and noise in counts."""
    low, high = ends
    span = max(high - low, LEAST_NOISES * noise, 1e-9)
    return np.array([0.5 * (low + high - span), math.log(span)])


def to_bgr8(image: NDArray) -> NDArray[np.uint8]:
    """Convert an image to (h, w, 3) BGR of 8 bits; other depths are scaled by an `AutomaticGain` of its own.

    Raises ValueError for an empty array and for a shape other than (h, w) or (h, w, 1|3|4).
    """
    if image.size == 0 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3, 4)):
        raise ValueError(f'an array of shape {image.shape} is no image, expected (h, w) or (h, w, 1|3|4)')
    image = AutomaticGain().apply(image, 0.0)
    if image.ndim == 2 or image.shape[2] == 1:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGRA2BGR) if image.shape[2] == 4 else image, np.uint8)


def decode_image(data: bytes | memoryview, flags: int, most_pixels: int = MOST_PIXELS, any_format: bool = False) -> NDArray:
    """The image (h, w[, channels]) in a JPEG or PNG file. Raises ValueError if it is neither, damaged or too large.

    Parameters:
        data: content of the file.
        flags: OpenCV's IMREAD flags.
        most_pixels: maximum number of pixels.
        any_format: whether it may be in another format of OpenCV: a file of the user.
    """
    if not any_format or bytes(data[:len(PNG)]).startswith((JPEG, PNG)):    # OpenCV takes memory for what these formats claim
        check_pixels(*size_of(data), most_pixels)
    reason = 'of no known format, or damaged'
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        image, reason = None, error.err
    if image is None:
        raise ValueError(f'image of {len(data)} bytes cannot be decoded: {reason}')
    check_pixels(image.shape[1], image.shape[0], most_pixels)
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
    """Width and height in the header of a JPEG file, or of a PNG file that is whole. Raises ValueError for others."""
    data = bytes(data)
    size = _size_of_png(data) if data.startswith(PNG) else _size_of_jpeg(data) if data.startswith(JPEG) else None
    if size is None:
        raise ValueError(f'image of {len(data)} bytes cannot be decoded: expected a complete header of JPEG, or a whole PNG')
    return size


def _size_of_png(data: bytes) -> tuple[int, int] | None:
    """The size in the first chunk of a whole file: OpenCV takes memory for what a chunk claims, and reads no other files."""
    position = len(PNG)
    for _ in range(MOST_CHUNKS):
        if position + _CHUNK.size > len(data):
            return None
        length, kind = _CHUNK.unpack_from(data, position)
        end = position + _CHUNK.size + length + 4
        if end > len(data) or (position == len(PNG) and (length, kind) != (13, b'IHDR')):
            return None
        if kind == b'IEND':
            width, height = _SIDES.unpack_from(data, len(PNG) + _CHUNK.size)
            return width, height
        position = end
    return None


def _size_of_jpeg(data: bytes) -> tuple[int, int] | None:
    """The size in the first frame header, found as libjpeg finds it: bytes between segments are skipped."""
    if data.count(b'\xff\xda') > MOST_SCANS:
        raise ValueError(f'image: a JPEG of more than {MOST_SCANS} scans')
    position = len(JPEG)
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
