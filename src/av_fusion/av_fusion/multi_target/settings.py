"""Settings of the multi-target filter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from av_fusion.filter.settings import BayesSettings


@dataclass(frozen=True)
class MultiTargetSettings:
    """Settings of `MultiTargetFilter`.

    Parameters:
        target: models of each target and of the sensors.
        acceleration_density (rad^2/s^3), elevation_density (rad^2/s), rate_sigma (rad/s): of several targets, in place of those
            of a single one. They are told apart by steady motion: the acceleration is that of a steady flight, until
            innovations raise it.
        undetected_first: expected number of targets in the sky before the first scan.
        undetected: expected number of targets that were not detected yet, later on.
        sound_detection_probability: that a target that can be heard is among the directions of arrival of a window.
        unheard_rate: long-run probability that a target cannot be heard, because louder ones mask it.
        unheard_time (s): correlation time of that state.
        least_existence: a track of smaller existence probability ends.
        confirmed: existence probability from which a track is reported.
        duplicate_time (s): two tracks that agree become one when no scan has told them apart for so long, or ever.
        most_tracks: the least certain tracks beyond this number end.
        policy: which target is followed, see `TargetSelector`.
        visits: whether a camera on a gimbal visits several targets in turn, instead of the followed one alone.
        dwell (s): duration of a visit.
        types: blade-pass frequency (Hz) of each type of drone that is named when it is heard.
    """

    target: BayesSettings = field(default_factory=BayesSettings)
    acceleration_density: float = 0.0003
    elevation_density: float = 0.0003
    rate_sigma: float = 0.15
    undetected_first: float = 1.0
    undetected: float = 0.1
    sound_detection_probability: float = 0.9
    unheard_rate: float = 0.3
    unheard_time: float = 1.0
    least_existence: float = 0.01
    confirmed: float = 0.5
    duplicate_time: float = 10.0
    most_tracks: int = 50
    policy: str = 'certain'
    visits: bool = False
    dwell: float = 1.0
    types: Mapping[str, float] = field(default_factory=dict)
