"""The algorithms as the nodes' parameters describe them."""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from av_audio.localizer import LocalizerSettings
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy
from av_fusion.bayes import BayesSettings, BayesTracker
from av_fusion.gated import GatedSettings, GatedTracker
from av_fusion.limited_axis import AxisLimits
from av_fusion.machine import MachineSettings
from av_fusion.pointing import PointingSettings
from av_fusion.rotation import RotationSettings
from av_vision.camera import PinholeCamera
from av_vision.models import shipped_model
from av_vision.visibility import ground_distances
from av_vision.yolo import Detector, DetectorSettings


def localizer_settings(p: Any) -> LocalizerSettings:
    """Of the parameters of doa_node. Raises ValueError."""
    return LocalizerSettings(
        window_s=p.window, hop_s=p.hop, band_hz=(p.band_low, p.band_high), method=p.method,
        temperature_c=p.temperature, elevation_deg=(p.elevation_min_deg, p.elevation_max_deg),
        estimated_rotors=p.own_rotor_count if p.own_rotors == 'estimated' else 0)


def make_detector(p: Any) -> Detector:
    """Of the parameters of detector_node. Raises ModelError or ValueError."""
    return Detector(shipped_model() if p.model in ('', 'shipped') else p.model, DetectorSettings(
        score_threshold=p.score_threshold, nms_iou=p.nms_iou, max_detections=p.max_detections,
        keep=(p.target_class,), rename=dict.fromkeys(filter(None, p.keep_classes), p.target_class), layout=p.layout,
        class_names=tuple(filter(None, p.class_names)), input_size=p.input_size, slice_size=p.slice_size,
        providers=tuple(p.providers), threads=p.threads))


def ground(p: Any, camera: PinholeCamera) -> NDArray | None:
    """Distances (h, w) in m of flat ground to the camera that the parameters of detector_node describe, if they do."""
    if p.camera_height <= 0.0:
        return None
    pitch = rotation_from_rpy(0.0, math.radians(p.camera_pitch_deg), 0.0)
    return ground_distances(camera, p.camera_height, pitch @ FLU_TO_OPTICAL.T)


def make_tracker(p: Any) -> BayesTracker | GatedTracker:
    """Of the parameters of fusion_node."""
    machine = MachineSettings(p.tau, p.hysteresis, p.dwell, p.sight_timeout, p.sound_timeout)
    rotation = {'enabled': p.rotation.enabled, 'patience': p.rotation.patience,
                'sector': math.radians(p.rotation.sector_deg), 'fixed': math.radians(p.rotation.fixed_deg)}
    delays = {'sound_delay': p.sound_delay, 'sight_delay': p.sight_delay}
    if p.method == 'gated':
        rotation['fixed'] = rotation['fixed'] or RotationSettings().largest / 2.0
        return GatedTracker(GatedSettings(machine=machine, rotation=RotationSettings(**rotation), **delays))
    return BayesTracker(BayesSettings(
        machine=machine, rotation=RotationSettings(**rotation), acceleration_density=p.acceleration_density,
        rate_sigma=math.radians(p.rate_sigma_deg), decide=p.decide_probability, recall=p.recall,
        assumed_visibility=p.assumed_visibility, **delays))


def pointing_settings(p: Any) -> PointingSettings:
    """Of the parameters of pointing_node. Raises ValueError on stops that exclude 0."""
    gimbal = (math.radians(p.gimbal_rate_deg), math.radians(p.gimbal_acceleration_deg))
    return PointingSettings(
        pan=AxisLimits(*gimbal, *map(math.radians, p.pan_limits_deg)),
        tilt=AxisLimits(*gimbal, *map(math.radians, p.tilt_limits_deg)),
        yaw=AxisLimits(math.radians(p.yaw_rate_deg), math.radians(p.yaw_acceleration_deg)),
        search_rate=math.radians(p.search_rate_deg), dead_band=math.radians(p.dead_band_deg), lead=p.lead,
        stale_after=p.stale_after, on_stale=p.on_stale, move_gimbal=p.move_gimbal, move_body=p.move_body,
        body_follows_at=math.radians(p.body_follows_at_deg))
