"""Hearing and seeing as the parameters of their nodes describe them."""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from av_audio.localizer import LocalizerSettings
from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy
from av_vision.visibility import ground_distances


def localizer_settings(p: Any) -> LocalizerSettings:
    """Of the parameters of doa_node. Raises ValueError."""
    return LocalizerSettings(
        window_s=p.window, hop_s=p.hop, band_hz=(p.band_low, p.band_high), method=p.method,
        temperature_c=p.temperature, elevation_deg=(p.elevation_min_deg, p.elevation_max_deg),
        estimated_rotors=p.ego_rotor_count if p.ego_rotors == 'estimated' else 0)


def ground(p: Any, camera: PinholeCamera) -> NDArray | None:
    """Distances (h, w) in m of flat ground to the camera that the parameters of detector_node describe, if they do."""
    if p.camera_height <= 0.0:
        return None
    pitch = rotation_from_rpy(0.0, math.radians(p.camera_pitch_deg), 0.0)
    return ground_distances(camera, p.camera_height, pitch @ FLU_TO_OPTICAL.T)
