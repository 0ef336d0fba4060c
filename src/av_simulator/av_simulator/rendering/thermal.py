"""Thermal images by a simple model: each object has one temperature, which fog blends with that of the air."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DRONE_WARMER_K = 15.0    # K, motors and battery relative to the air
GROUND_WARMER_K = 1.0    # K, ground relative to the air
SKY_COLDER_K = 25.0      # K, air relative to a clear sky at the zenith; the horizon has the air's temperature
FOG_SHARE = 0.7          # ratio of fog's extinction in the thermal infrared to that of visible light


def thermal_image(warmer_k: NDArray, sky: NDArray, upward: NDArray, optical_depth: NDArray, air_c: float) -> NDArray:
    """Apparent temperatures (deg C, (height, width), float32).

    Parameters:
        warmer_k (K, (height, width)): temperature of the object at each pixel, relative to the air.
        sky ((height, width), bool): pixels of the sky.
        upward ((height, width)): z component of each pixel's ray in ENU.
        optical_depth ((height, width)): optical depth of the air for visible light.
        air_c (deg C): temperature of the air.
    """
    surface = np.where(sky, -SKY_COLDER_K * np.sqrt(upward.clip(0.0, 1.0)), warmer_k)
    return (air_c + surface * np.exp(-FOG_SHARE * optical_depth)).astype(np.float32)
