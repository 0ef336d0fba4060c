"""Settings of the filter."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from av_fusion.tracks.motion import MotionModel


@dataclass(frozen=True)
class FilterSettings:
    """Models of targets and sensors.

    Parameters:
        model: motion of targets.
        rate_sigma (rad/s): prior standard deviation of the angular rate.
        loss_rate (1/s): rate at which targets disappear.
        sound_floor_sigma (rad): error of directions of arrival beyond what they report.
        sound_detection_probability: that a target that can be heard is among the directions of arrival of a window.
        masked: probability that a target is not among them where another one is: louder ones hide it.
        unheard_rate, unheard_time (s): long-run probability that louder sources mask a target, and correlation time of that.
        detection_probability: probability that a visible target in view is detected.
        sight_correlation (s): correlation time of the errors of successive images.
        assumed_visibility: visibility (0..1) of images without one.
        undetected_first, undetected: expected number of targets in the sky that were not detected, at first and later on.
        least_existence: a track of smaller existence probability ends, and none begins: an unlikely source in one of five
            windows that overlap.
        confirmed: existence probability from which a track is reported.
        duplicate_time (s): two tracks that agree become one when no scan has told them apart for so long, or ever.
        most_tracks: the least certain tracks beyond this number end.
    """

    model: MotionModel = field(default_factory=MotionModel)
    rate_sigma: float = 0.3
    loss_rate: float = 0.002
    sound_floor_sigma: float = math.radians(0.5)
    sound_detection_probability: float = 0.9
    masked: float = 0.5
    unheard_rate: float = 0.3
    unheard_time: float = 1.0
    detection_probability: float = 0.9
    sight_correlation: float = 0.3
    assumed_visibility: float = 0.0
    undetected_first: float = 1.0
    undetected: float = 0.05
    least_existence: float = 0.002
    confirmed: float = 0.5
    duplicate_time: float = 10.0
    most_tracks: int = 50
