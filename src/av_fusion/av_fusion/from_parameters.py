"""Tracker and pointing as the parameters of their nodes describe them."""

from __future__ import annotations

import math
from typing import Any

from av_fusion.bayes import BayesSettings, BayesTracker
from av_fusion.gated import GatedSettings, GatedTracker
from av_fusion.limited_axis import AxisLimits
from av_fusion.machine import MachineSettings
from av_fusion.pointing import PointingSettings
from av_fusion.refinement import RefinementSettings
from av_fusion.rotation import RotationSettings


def make_tracker(p: Any) -> BayesTracker | GatedTracker:
    """Of the parameters of fusion_node."""
    machine = MachineSettings(p.tau, p.hysteresis, p.dwell, p.sight_timeout, p.sound_timeout)
    rotation = {'enabled': p.rotation.enabled, 'patience': p.rotation.patience,
                'sector': math.radians(p.rotation.sector_deg), 'fixed': math.radians(p.rotation.fixed_deg)}
    delays = {'sound_delay': p.sound_delay, 'sight_delay': p.sight_delay}
    if p.method == 'gated':
        rotation['fixed'] = rotation['fixed'] or GatedSettings().rotation.fixed
        return GatedTracker(GatedSettings(machine=machine, rotation=RotationSettings(**rotation), **delays))
    return BayesTracker(BayesSettings(
        machine=machine, rotation=RotationSettings(**rotation), acceleration_density=p.acceleration_density,
        rate_sigma=math.radians(p.rate_sigma_deg), coast=p.coast, decide=p.decide_probability, recall=p.recall,
        assumed_visibility=p.assumed_visibility,
        refinement=RefinementSettings(p.refinement.enabled, p.refinement.memory), **delays))


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
