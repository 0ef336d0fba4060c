"""Effects of the camera on an image: exposure, motion blur, rain in front of the lens, noise.

Of a thermal camera: apparent temperatures of what is seen, and the pictures that an uncooled one makes of them.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.constants import zero_Celsius

from av_simulator.rendering.view import View
from av_vision.image import HIGH, LOW, AutomaticGain, coarse_mean

SHUTTER_S = 1.0 / 100.0     # exposure time; the camera compensates for less light by gain
LONGEST_BLUR_PX = 50.0      # size of the largest kernel
READ_NOISE = 1.5            # standard deviation in grey levels at an exposure of 1
SHOT_NOISE = 0.12           # standard deviation over the square root of the grey level, at an exposure of 1
_DROP_LENGTH_PX, _DROPS_PER_MM_H = 22.0, 12.0
# K relative to the air, about what thermograms of hovering multirotors show; MuJoCo's shapes of the drone's parts.
MOTOR_WARMER_K, BODY_WARMER_K, ARM_WARMER_K, BLADE_WARMER_K = 25.0, 15.0, 6.0, 0.5
GROUND_WARMER_K = 1.0    # K, ground relative to the air
TEXTURE_K = 1.0          # K between black and white surfaces of one kind: bark, grass, walls store and emit heat unevenly
HORIZON_COLDER_K, SKY_COLDER_K = 6.0, 25.0  # K, air relative to a clear sky above the horizon, and at the zenith
FOG_SHARE = 0.7          # ratio of fog's extinction in the thermal infrared to that of visible light
REMOVED = 0.9            # share of the mean all around that the electronics take out: real skies are darkest at the horizon
COUNTS_PER_K = 100.0     # raw counts are hundredths of a kelvin from absolute zero, as radiometric cameras give them
SKY_DISTANCE = 3000.0    # m, length of the path through fog to the sky
AIRLIGHT = np.array([205.0, 205.0, 203.0], np.float32)  # colour of thick fog by day: blue, green, red

# An uncooled microbolometer of 12 um pixels behind a lens of f/1.
OPTICS_PX = 0.7                          # standard deviation of the image of a point
BLOOM_SHARE, BLOOM_PX = 0.06, 4.0        # of the heat that is scattered in lens and housing, and how far
RESPONSE_S = 0.010                       # thermal time constant of a pixel, which smears what moves
NOISE_K = 0.05                           # noise-equivalent temperature difference
FIXED_K, COLUMN_K, ROW_K = 0.03, 0.03, 0.02  # what the flat-field correction leaves: of pixels, columns, rows
SHADING_K = 0.3                          # warmth of the housing in the corners, since the last correction


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


def apparent_temperature(warmer_k: NDArray, sky: NDArray, upward: NDArray, optical_depth: NDArray, air_c: float) -> NDArray:
    """Apparent temperatures (deg C, (height, width), float32).

    Parameters:
        warmer_k (K, (height, width)): temperature of the object at each pixel, relative to the air.
        sky ((height, width), bool): pixels of the sky.
        upward ((height, width)): z component of each pixel's ray in ENU.
        optical_depth ((height, width)): optical depth of the air for visible light.
        air_c (deg C): temperature of the air.
    """
    above = -HORIZON_COLDER_K - (SKY_COLDER_K - HORIZON_COLDER_K) * np.sqrt(upward.clip(0.0, 1.0))
    surface = np.where(sky, above, warmer_k)
    return (air_c + surface * np.exp(-FOG_SHARE * optical_depth)).astype(np.float32)


class ThermalCamera:
    """Pictures of one thermal camera.

    Parameters:
        width, height (px): size of the images.
        palette: `white_hot` or `black_hot` for grey levels by the camera's own gain, `raw` for counts.
        seed: seed of all noise.
    """

    def __init__(self, width: int, height: int, palette: str, seed: int) -> None:
        self._palette, self._seed = palette, seed
        random = np.random.default_rng([seed, 19])
        rows, columns = np.mgrid[-1.0:1.0:height * 1j, -1.0:1.0:width * 1j]
        self._fixed = (random.normal(0.0, FIXED_K, (height, width)) + random.normal(0.0, COLUMN_K, (1, width))
                       + random.normal(0.0, ROW_K, (height, 1)) + 0.5 * SHADING_K * (rows**2 + columns**2)).astype(np.float32)
        self._noise = random.normal(0.0, NOISE_K, (2 * height, 2 * width)).astype(np.float32)  # drawn once, then shifted

    def picture(self, temperature_c: NDArray[np.float32], view: View) -> NDArray:
        """Grey levels (height, width) uint8, or raw counts uint16.

        Parameters:
            temperature_c (deg C, (height, width)): apparent temperatures.
            view: number and motion of the image.
        """
        height, width = temperature_c.shape
        seen = motion_blurred(temperature_c, view.image_motion, RESPONSE_S)
        sharp = cv2.GaussianBlur(seen, (0, 0), OPTICS_PX)
        seen = (1.0 - BLOOM_SHARE) * sharp + BLOOM_SHARE * cv2.GaussianBlur(seen, (0, 0), BLOOM_PX)
        row, column = np.random.default_rng([self._seed, 20, view.index]).integers([height, width])
        seen = seen + self._fixed + self._noise[row:row + height, column:column + width]
        counts = np.clip((seen + zero_Celsius) * COUNTS_PER_K, 0, 65_535).astype(np.uint16)
        return counts if self._palette == 'raw' else self._developed(counts)

    def _developed(self, counts: NDArray[np.uint16]) -> NDArray[np.uint8]:
        """Grey levels as the camera's electronics make them: less of what is warm all around, which darkens the horizon."""
        heat = counts.astype(np.float32)
        cells = coarse_mean(heat.clip(*np.percentile(heat[::4, ::4], (LOW, HIGH))))
        around = cv2.resize(cells, heat.shape[::-1], interpolation=cv2.INTER_LINEAR)
        grey = AutomaticGain().apply(heat - REMOVED * around, 0.0)
        return 255 - grey if self._palette == 'black_hot' else grey
