"""Conversion of images of any depth to the 8-bit BGR images of a detector."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

LOW, HIGH = 1.0, 99.0  # percentiles that become black and white
GAIN_S = 1.0           # time constant with which they follow the scene: below the rate at which flicker disturbs a detector
LEAST_NOISES = 20.0    # standard deviations of the noise that the range holds: a plain sky is shown as grey, not as noise
NORMAL_MAD = 1.4826    # standard deviation of normal values over their median absolute deviation


class AutomaticGain:
    """Maps raw counts of a sensor, such as those of a thermal camera, to 8 bits with a range that follows the scene slowly."""

    def __init__(self) -> None:
        self._range, self._time, self._shape = np.zeros(2), -math.inf, (0, 0)  # black, and the logarithm of the span

    def apply(self, image: NDArray, time: float) -> NDArray[np.uint8]:
        """The image in 8 bits; one that has 8 bits is returned as it is.

        Parameters:
            image (h, w[, channels]): raw counts; values that are not finite count as 0.
            time (s): capture time; after an earlier one, and for another size, the range begins anew.
        """
        if image.dtype == np.uint8:
            return image
        counts = np.nan_to_num(image.astype(np.float32), posinf=0.0, neginf=0.0)
        newest = range_of(counts[::4])
        if image.shape[:2] != self._shape or time < self._time:
            self._range, self._shape = newest, image.shape[:2]
        else:
            self._range += (1.0 - math.exp((self._time - time) / GAIN_S)) * (newest - self._range)
        self._time = time
        black, log_span = self._range
        return np.clip((counts - black) * (255.0 / math.exp(log_span)), 0, 255).astype(np.uint8)


def range_of(counts: NDArray[np.float32]) -> NDArray[np.float64]:
    """Black, and the logarithm of the span from black to white, in counts of some rows (h, w[, channels]) of an image."""
    low, high = np.percentile(counts[:, ::4], (LOW, HIGH))
    # Neighbours see almost the same: half of their differences are smaller than the median.
    noise = NORMAL_MAD * float(np.median(np.abs(np.diff(counts, axis=1)))) / math.sqrt(2.0) if counts.shape[1] > 1 else 0.0
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
