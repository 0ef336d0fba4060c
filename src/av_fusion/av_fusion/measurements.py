"""What the trackers are told and what they tell, as plain data.

Azimuths are in rad, counter-clockwise; "body" is the rig's levelled frame (x forward), "world" is ENU. Times are capture
times in seconds.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field


class State(enum.IntEnum):
    """State of the machine; the values of `av_interfaces/Bearing`."""

    NONE = 0
    VISUAL_ACTIVE = 1
    ACOUSTIC_ACTIVE = 2
    COASTING = 3


class Source(enum.IntFlag):
    """The senses a bearing rests on; the values of `av_interfaces/Bearing`."""

    NOTHING = 0
    SOUND = 1
    SIGHT = 2


@dataclass(frozen=True)
class Hypothesis:
    """One direction (body frame, rad, rad^2) that a sound may have come from."""

    azimuth: float
    azimuth_variance: float
    elevation: float = 0.0
    elevation_variance: float = math.inf


@dataclass(frozen=True)
class Sound:
    """One sound heard: its hypotheses are mirror images, of which exactly one is true.

    `window` in s is the length of sound that the estimate rests on: estimates that overlap are not independent.
    """

    time: float
    hypotheses: tuple[Hypothesis, ...]
    confidence: float
    window: float = 0.5


@dataclass(frozen=True)
class Detection:
    """One thing seen (body frame, rad, rad^2), with the detector's calibrated confidence 0..1."""

    azimuth: float
    azimuth_variance: float
    confidence: float
    elevation: float = 0.0
    elevation_variance: float = math.inf


@dataclass(frozen=True)
class Look:
    """One picture looked at, with all that was detected in it, be it nothing.

    The view is centred at `view_azimuth` (body, rad) and reaches `half_view` (rad) to both sides. `visibility` (0..1) is
    how well a target would be seen, nan when unknown.
    """

    time: float
    detections: tuple[Detection, ...]
    view_azimuth: float = 0.0
    half_view: float = 0.6
    visibility: float = math.nan

    @property
    def best(self) -> Detection | None:
        """The detection of highest confidence."""
        return max(self.detections, key=lambda detection: detection.confidence, default=None)


@dataclass(frozen=True)
class Track:
    """The target as known at `time`; angles mean nothing in `State.NONE`."""

    time: float
    state: State = State.NONE
    reason: str = 'nothing heard or seen yet'
    changed: float = 0.0
    source: Source = Source.NOTHING
    azimuth: float = math.nan
    elevation: float = 0.0
    azimuth_variance: float = math.inf
    elevation_variance: float = math.inf
    azimuth_world: float = math.nan
    azimuth_world_rate: float = 0.0
    measured: float = 0.0
    front_probability: float = 0.5
    resolved: bool = False
    requested_rotation: float = 0.0
    sound_confidence: float = 0.0
    sight_confidence: float = 0.0
    sound_weight: float = 0.0
    sight_weight: float = 0.0
    visibility: float = math.nan
    missing: tuple[str, ...] = field(default=())

    @property
    def hemisphere_probability(self) -> float:
        """Probability 0.5..1 that the hemisphere of the bearing is the right one."""
        return max(self.front_probability, 1.0 - self.front_probability)
