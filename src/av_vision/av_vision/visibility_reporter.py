"""Estimates visibility in a stream of images at a limited rate, with distances from depth images or flat ground."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL
from av_common.stamps import to_seconds
from av_vision.messages import image_from_message
from av_vision.visibility import Visibility, estimate, ground_distances

LARGEST_DEPTH_AGE_S = 0.2  # an older depth image belongs to another scene


@dataclass(frozen=True)
class VisibilitySettings:
    """Rate and scene of estimates of visibility.

    Parameters:
        rate (1/s): rate of estimates; 0 for none.
        target_distance (m): distance for which the share of contrast is reported.
        camera_height (m): height over flat ground; 0 when unknown.
    """

    rate: float = 2.0
    target_distance: float = 10.0
    camera_height: float = 0.0


class VisibilityReporter:
    """Estimates visibility in some of the images.

    Distances come from depth images, or from the camera's height over flat ground; without either only the share of contrast
    that is left in the image is known.

    Parameters:
        settings: rate and scene.
    """

    def __init__(self, settings: VisibilitySettings) -> None:
        self._settings = settings
        self._next = -math.inf
        self._depth: tuple[float, NDArray] | None = None  # time in s, image

    def on_depth(self, message: Any) -> None:
        """Use a depth image (`sensor_msgs/Image`, 16UC1 in mm or 32FC1 in m), aligned to the colour image.

        Raises ValueError for an image that cannot be read.
        """
        self._depth = to_seconds(message.header.stamp), image_from_message(message)

    def report(self, image: NDArray, time: float, camera: PinholeCamera | None = None,
               rotation: NDArray | None = None) -> Visibility | None:
        """The visibility in an image, None when no estimate is due.

        Parameters:
            image (h, w[, channels]): BGR, grey or 16-bit.
            time (s): time of capture; a time more than a period before the last estimate (a looped file) restarts the rate.
            camera: of this image, for flat ground; None while unknown.
            rotation (3, 3): from its optical frame to a level frame; None where unknown: it looks level.
        """
        rate = self._settings.rate
        if rate <= 0.0 or self._next - 1.0 / rate <= time < self._next:
            return None
        self._next = time + 1.0 / rate
        level = FLU_TO_OPTICAL.T if rotation is None else rotation
        distance = self._distance((image.shape[0], image.shape[1]), time, camera, level)
        return estimate(image, distance, self._settings.target_distance)

    def reset(self) -> None:
        """Estimate visibility in the next image, and discard the last depth image."""
        self._next, self._depth = -math.inf, None

    def _distance(self, shape: tuple[int, int], time: float, camera: PinholeCamera | None,
                  rotation: NDArray) -> NDArray | None:
        if self._depth is not None and abs(self._depth[0] - time) <= LARGEST_DEPTH_AGE_S:
            depth = self._depth[1]
            if depth.shape != shape:
                return None
            return np.asarray(depth.astype(np.float32) * (1e-3 if depth.dtype == np.uint16 else 1.0))
        height = self._settings.camera_height
        if camera is None or not height > 0.0:
            return None
        return ground_distances(camera, height, rotation)
