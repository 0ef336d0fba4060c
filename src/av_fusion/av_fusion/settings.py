"""Trackers from the parameters of fusion_node."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from av_common.rig import GimbalMount
from av_fusion.baseline.gated_tracker import GatedSettings, GatedTracker
from av_fusion.calibration.array_calibration import SelfCalibrationSettings
from av_fusion.disambiguation.rotation import RotationSettings
from av_fusion.filter.settings import BayesSettings
from av_fusion.filter.state_machine import MachineSettings
from av_fusion.gimbal_stage import JointNames
from av_fusion.methods import TRACKERS
from av_fusion.multi_target.blade_pass import HIGHEST_HZ, LOWEST_HZ
from av_fusion.multi_target.settings import MultiTargetSettings
from av_fusion.multi_target.tracker import MultiTargetTracker
from av_fusion.tracker_protocol import Tracker


def make_tracker(parameters: Any, gimbal: GimbalMount | None = None) -> Tracker:
    """The tracker that the parameters of fusion_node describe. Raises ValueError for values that contradict each other.

    Parameters:
        parameters: the node's parameters; `method` may name a tracker of another package.
        gimbal: carries the camera; None where that is fixed.
    """
    tracker: Tracker = TRACKERS.load(parameters.method)(parameters, gimbal)
    return tracker


def own_tracker(parameters: Any, gimbal: GimbalMount | None = None) -> Tracker:
    """The suite's filter, or the published switch. See `make_tracker`.

    Parameters:
        parameters, gimbal: as for `make_tracker`.
    """
    p = parameters
    machine = MachineSettings(p.tau, p.hysteresis, p.dwell, p.sight_timeout, p.sound_timeout)
    fixed = math.radians(p.rotation.fixed_deg)
    if p.method == 'gated':
        fixed = fixed or GatedSettings().rotation.fixed
    rotation = RotationSettings(enabled=p.rotation.enabled, patience=p.rotation.patience,
                                sector=math.radians(p.rotation.sector_deg), fixed=fixed)
    if p.method == 'gated':
        return GatedTracker(GatedSettings(machine=machine, rotation=rotation, sound_delay=p.sound_delay,
                                          sight_delay=p.sight_delay))
    target = BayesSettings(
        machine=machine, rotation=rotation, acceleration_density=p.acceleration_density,
        rate_sigma=math.radians(p.rate_sigma_deg), coast=p.coast, confirm_threshold=p.confirm_threshold,
        detection_probability=p.detection_probability, assumed_visibility=p.assumed_visibility,
        self_calibration=SelfCalibrationSettings(p.self_calibration.enabled, p.self_calibration.memory),
        gimbal=gimbal if p.look.enabled else None, sound_delay=p.sound_delay, sight_delay=p.sight_delay)
    return MultiTargetTracker(MultiTargetSettings(
        target, acceleration_density=p.targets.acceleration_density, policy=p.targets.policy,
        visits=p.look.visits, dwell=p.look.dwell, types=types_of(p.targets.types)))


def types_of(entries: Sequence[str]) -> dict[str, float]:
    """Blade-pass frequencies (Hz) by type of drone. Raises ValueError for an entry that is not 'name: frequency'.

    Parameters:
        entries: such as 'hexarotor: 133'; empty ones are ignored.
    """
    types = {}
    for entry in filter(None, entries):
        name, _, frequency = entry.rpartition(':')
        try:
            types[name.strip()] = float(frequency)
        except ValueError:
            types[name.strip()] = math.nan
        if not (name.strip() and LOWEST_HZ <= types[name.strip()] <= HIGHEST_HZ):
            raise ValueError(f"targets.types: {entry!r}, expected a name and {LOWEST_HZ:g} to {HIGHEST_HZ:g} Hz, "
                             "such as 'hexarotor: 133'")
    return types


def joint_names(parameters: Any) -> JointNames:
    """The gimbal's joints that the parameters of rig_frames_node describe."""
    joints = parameters.joints
    return JointNames(joints.pan, joints.tilt, joints.roll, math.radians(joints.sigma_deg))
