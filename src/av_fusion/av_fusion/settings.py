"""The tracker as the parameters of fusion_node describe it."""

from __future__ import annotations

import math
from typing import Any

from av_fusion.baseline.gated_tracker import GatedSettings, GatedTracker
from av_fusion.calibration.array_calibration import RefinementSettings
from av_fusion.disambiguation.rotation import RotationSettings
from av_fusion.filter.state_machine import MachineSettings
from av_fusion.filter.tracker import BayesSettings, BayesTracker


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
