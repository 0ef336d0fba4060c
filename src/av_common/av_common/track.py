"""The target as the rig knows it: plain data between fusion, pointing, replay and messages."""

from __future__ import annotations

import enum
import math
from typing import NamedTuple


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


class Track(NamedTuple):
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
    missing: tuple[str, ...] = ()

    @property
    def hemisphere_probability(self) -> float:
        """Probability 0.5..1 that the hemisphere of the bearing is the right one."""
        return max(self.front_probability, 1.0 - self.front_probability)
