"""The ground as the parameters of detector_node describe it."""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy
from av_vision.visibility import ground_distances


def ground(p: Any, camera: PinholeCamera) -> NDArray | None:
    """Distances (h, w) in m of flat ground to the camera that the parameters of detector_node describe, if they do."""
    if p.camera_height <= 0.0:
        return None
    pitch = rotation_from_rpy(0.0, math.radians(p.camera_pitch_deg), 0.0)
    return ground_distances(camera, p.camera_height, pitch @ FLU_TO_OPTICAL.T)
