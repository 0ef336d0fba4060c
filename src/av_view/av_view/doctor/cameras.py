"""The camera: whether its pictures come at the rate that was asked for, and whether something can be seen in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from av_view.doctor.finding import Finding
from av_vision.image import to_bgr8

AREA = 'camera'
LEAST_SHARE = 0.8  # of the rate that was asked for
DARK, BRIGHT = 25.0, 235.0  # mean of 8 bits
BURNT = 0.3  # share of pixels at full scale
STILL = 0.05  # mean difference of pixels between images, below which nothing changes at all: real sensors have noise


def judge_images(times: Sequence[float], images: Sequence[NDArray], wanted_rate: float, wanted_size: tuple[int, int],
                 ) -> list[Finding]:
    """Judge what a camera has delivered.

    Parameters:
        times (s): capture times, rising.
        images (h, w[, channels]): some of the images.
        wanted_rate (Hz): rate that was asked for; 0 for none.
        wanted_size: width and height (pixels) that were asked for.
    """
    if len(times) < 2 or not images:
        return [Finding(AREA, 'error', 'no images arrive', 'unplug it and plug it in again; is another program using it?')]
    rate = (len(times) - 1) / max(times[-1] - times[0], 1e-9)
    height, width = images[-1].shape[:2]
    found = []
    if rate < LEAST_SHARE * wanted_rate:
        found.append(Finding(AREA, 'warning', f'{rate:.1f} pictures a second come instead of {wanted_rate:.0f}',
                             'more light or a shorter exposure_ms; a smaller width; USB 3 instead of 2'))
    if (width, height) != wanted_size:
        found.append(Finding(AREA, 'warning', f'pictures are {width}x{height} instead of {wanted_size[0]}x{wanted_size[1]}',
                             f'set width and height of camera_node, and of the rig\'s camera, to {width} and {height}'))
    grey = np.stack([to_bgr8(image).mean(axis=2) for image in images])
    level = float(grey.mean())
    if level < DARK:
        found.append(Finding(AREA, 'warning', f'pictures are dark: {level:.0f} of 255', 'the lens cap? raise exposure_ms'))
    if level > BRIGHT or float((grey > 254.0).mean()) > BURNT:
        found.append(Finding(AREA, 'warning', f'pictures are overexposed: mean {level:.0f} of 255', 'lower exposure_ms'))
    if len(grey) > 1 and float(np.abs(np.diff(grey, axis=0)).mean()) < STILL:
        found.append(Finding(AREA, 'warning', 'all pictures are the same', 'is this a camera, or a file or a test pattern?'))
    return found or [Finding(AREA, 'ok', f'{rate:.1f} pictures of {width}x{height} a second')]
