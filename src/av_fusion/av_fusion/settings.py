"""Trackers from the parameters of fusion_node."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from av_common.methods import Methods
from av_common.rig import GimbalMount
from av_fusion.identity.blade_pass import HIGHEST_HZ, LOWEST_HZ
from av_fusion.plain_tracker import PlainTracker
from av_fusion.state_machine import SIGHT_TIMEOUT_S, SOUND_TIMEOUT_S
from av_fusion.tracker import MultiTargetTracker, TrackerSettings
from av_fusion.tracks.settings import FilterSettings

# What makes a tracker takes the parameters of fusion_node and the gimbal or None.
TRACKERS = Methods('av_rig.trackers', {
    'bayes': 'av_fusion.settings:own_tracker',
    'gated': 'av_fusion.gated_tracker:GatedTracker',
})
Tracker = MultiTargetTracker | PlainTracker
LEAST_DETECTION = 0.1  # at 0.05 the drone of each of 60 images is followed in 10, at 0.1 in all


def make_tracker(parameters: Any, gimbal: GimbalMount | None = None) -> Tracker:
    """The tracker that the parameters of fusion_node describe. Raises ValueError for values that contradict each other.

    Parameters:
        parameters: the node's parameters; `method` may name a tracker of another package.
        gimbal: carries the camera; None where that is fixed.
    """
    tracker: Tracker = TRACKERS.load(parameters.method)(parameters, gimbal)
    return tracker


def check_sense(p: Any) -> None:
    """Raise ValueError for parameters by which nothing could be heard, seen or followed, although each is within its bounds.

    Parameters:
        p: the parameters of fusion_node.
    """
    for name, timeout in (('sound_delay', SOUND_TIMEOUT_S), ('sight_delay', SIGHT_TIMEOUT_S)):
        if abs(getattr(p, name)) >= timeout:
            raise ValueError(f'{name} is {getattr(p, name):g} s, but what is older than {timeout:g} s does not count; expected '
                             f'less, as `ros2 run av_evaluation estimate_latency` finds it')
    for name in ('tau', 'follow_threshold'):
        if getattr(p, name) >= 1.0:
            raise ValueError(f'{name} is {getattr(p, name):g}, which no score and no probability exceeds; expected less than '
                             '1, such as 0.5')
    if p.detection_probability < LEAST_DETECTION:
        raise ValueError(f'detection_probability is {p.detection_probability:g}, with which a drone in full view is not '
                         f'followed; expected {LEAST_DETECTION:g} or more, such as 0.9')


def own_tracker(parameters: Any, gimbal: GimbalMount | None = None) -> Tracker:
    """The suite's filter. See `make_tracker`.

    Parameters:
        parameters, gimbal: as for `make_tracker`.
    """
    p = parameters
    return MultiTargetTracker(TrackerSettings(
        FilterSettings(detection_probability=p.detection_probability, assumed_visibility=p.assumed_visibility),
        p.tau, p.confirm_threshold, p.rotation, self_calibration=p.self_calibration, follow_threshold=p.follow_threshold,
        policy=p.policy, gimbal=gimbal, types=types_of(p.types), sound_delay=p.sound_delay, sight_delay=p.sight_delay))


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
            raise ValueError(f"types: {entry!r}, expected a name and {LOWEST_HZ:g} to {HIGHEST_HZ:g} Hz, "
                             "such as 'hexarotor: 133'")
    return types
