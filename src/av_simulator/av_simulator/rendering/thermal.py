"""An image of temperatures, from a simple model: every thing has one, and fog veils it with that of the air."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DRONE_WARMER_K = 15.0    # motors and battery over the air
GROUND_WARMER_K = 1.0
SKY_COLDER_K = 25.0      # a clear sky at the zenith; the horizon is as warm as the air
FOG_SHARE = 0.7          # extinction of fog in the thermal infrared over that in the visible


def thermal_image(warmer_k: NDArray, sky: NDArray, upward: NDArray, optical_depth: NDArray, air_c: float) -> NDArray:
    """Apparent temperatures in degrees Celsius, float32 of the image's shape.

    warmer_k: how much warmer than the air each pixel's thing is.  sky: where there is none.  upward: z of each pixel's
    ray in ENU.  optical_depth: of the visible fog before it.
    """
    surface = np.where(sky, -SKY_COLDER_K * np.sqrt(upward.clip(0.0, 1.0)), warmer_k)
    return (air_c + surface * np.exp(-FOG_SHARE * optical_depth)).astype(np.float32)
