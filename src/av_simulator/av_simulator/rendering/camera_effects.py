"""Effects of the camera on an image: exposure, motion blur, rain in front of the lens, noise."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from av_simulator.rendering.view import View

SHUTTER_S = 1.0 / 100.0     # exposure time; the camera compensates for less light by gain
LONGEST_BLUR_PX = 50.0
READ_NOISE = 1.5            # standard deviation in grey levels at an exposure of 1
SHOT_NOISE = 0.12           # standard deviation over the square root of the grey level, at an exposure of 1
_DROP_LENGTH_PX, _DROPS_PER_MM_H = 22.0, 12.0


class CameraEffects:
    """Effects of one camera on images (height, width, 3) uint8.

    Parameters:
        width, height (px): size of the images.
        seed: seed of noise and rain.
    """

    def __init__(self, width: int, height: int, seed: int):
        self._seed = seed
        random = np.random.default_rng([seed, 13])
        # The noise is drawn once and shifted at random for each image: drawing it again would cost more than rendering.
        self._noise = random.standard_normal((2 * height, 2 * width)).astype(np.float32)
        self._shape = (height, width)

    def apply(self, bgr: NDArray, view: View) -> NDArray:
        """The image with all effects.

        Parameters:
            bgr ((height, width, 3), uint8): rendered image, including the effect of the air.
            view: light, exposure, motion and rain of the image.
        """
        bgr = motion_blurred(bgr, view.image_motion)
        if view.atmosphere.rain_mm_h > 0.0:
            bgr = self._rained(bgr, view)
        light = view.daylight * view.exposure
        if light != 1.0:
            gain: Any = (light,) * 4
            bgr = cv2.multiply(bgr, gain, dtype=cv2.CV_16S)    # values above white are clipped after the noise
        return self._noisy(bgr, view)

    def _noisy(self, bgr: NDArray, view: View) -> NDArray:
        random = np.random.default_rng([self._seed, 14, view.index])
        height, width = self._shape
        row, column = random.integers(height), random.integers(width)
        noise = self._noise[row:row + height, column:column + width]
        # Both parts of the noise grow with the square root of the gain.
        gain = np.sqrt(max(view.exposure, 1.0))
        level = (gain * np.sqrt(READ_NOISE**2 + SHOT_NOISE**2 * np.arange(256))).astype(np.float32)
        spread = cv2.LUT(cv2.convertScaleAbs(cv2.extractChannel(bgr, 1)), level)
        grey = cv2.multiply(noise, spread)
        return cv2.add(bgr, cv2.merge([grey, grey, grey]), dtype=cv2.CV_8U)

    def _rained(self, bgr: NDArray, view: View) -> NDArray:
        random = np.random.default_rng([self._seed, 15, view.index])
        height, width = self._shape
        count = int(_DROPS_PER_MM_H * view.atmosphere.rain_mm_h)
        streaks = np.zeros((height, width), np.uint8)
        begin = random.uniform(0.0, [width, height], (count, 2))
        length = _DROP_LENGTH_PX * random.uniform(0.4, 1.6, count)
        end = begin + np.column_stack([0.12 * length, length])
        for (x0, y0), (x1, y1), bright in zip(begin, end, random.integers(20, 70, count), strict=True):
            cv2.line(streaks, (int(x0), int(y0)), (int(x1), int(y1)), int(bright), 1, cv2.LINE_AA)
        return cv2.add(bgr, cv2.merge([streaks] * 3))


def motion_blurred(bgr: NDArray, image_motion: tuple[float, float], shutter_s: float = SHUTTER_S) -> NDArray:
    """The image with motion blur, of at most LONGEST_BLUR_PX.

    Parameters:
        bgr ((height, width, 3), uint8): image.
        image_motion (px/s, (2,)): motion of stationary objects in the middle of the image, x and y.
        shutter_s (s): exposure time.
    """
    x, y = np.multiply(image_motion, shutter_s)
    if np.hypot(x, y) < 1.0:
        return bgr
    x, y = np.array([x, y]) * min(1.0, LONGEST_BLUR_PX / np.hypot(x, y))
    half_x, half_y = int(np.ceil(abs(x) / 2)), int(np.ceil(abs(y) / 2 - 0.25))
    share = np.linspace(-0.5, 0.5, 8 * max(half_x, half_y) + 1)
    kernel = np.zeros((2 * half_y + 1, 2 * half_x + 1), np.float32)
    np.add.at(kernel, (np.rint(half_y + share * y).astype(int), np.rint(half_x + share * x).astype(int)), 1.0)
    return cv2.filter2D(bgr, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)


def contrast_left(view: View) -> float:
    """Factor (0 to 1) on the contrast of an image that is too dark or overexposed."""
    light = view.daylight * view.exposure
    return float(min(1.0, light / 0.3, (2.0 / light) ** 2 if light > 2.0 else 1.0))
