"""The track of a target as plain data, for fusion, pointing, replay and messages."""

from __future__ import annotations

import enum
import math
from typing import NamedTuple

DRONE = 'drone'  # class of detections that may be the target, and of tracks


class State(enum.IntEnum):
    """State of the tracker, with the values of `av_interfaces/Bearing`."""

    NONE = 0
    VISUAL_ACTIVE = 1
    ACOUSTIC_ACTIVE = 2
    COASTING = 3


class Source(enum.IntFlag):
    """Sensors that contribute to a bearing, with the values of `av_interfaces/Bearing`."""

    NOTHING = 0
    SOUND = 1
    SIGHT = 2


class Track(NamedTuple):
    """Estimate of the target at `time`; angles have no meaning in `State.NONE`.

    Parameters:
        time (s): ROS time for which the estimate holds.
        state, reason, changed (s): state of the tracker, reason of its last change, and time of that change.
        source: sensors with recent measurements of the track; NOTHING while it is a prediction.
        azimuth, elevation (rad), azimuth_variance, elevation_variance (rad^2): bearing in the body's frame.
        azimuth_world, elevation_world (rad), azimuth_world_rate, elevation_world_rate (rad/s): direction in the world's frame
            (ENU) and its rates.
        covariance_world (rad^2): of the direction's horizontal and vertical errors in the world, row-major.
        attitude_known: whether the rig's attitude is known; without it the rig counts as level, facing east.
        range (m), range_variance (m^2): distance of the target; NaN and inf where it is unknown.
        measured (s): capture time of the newest measurement associated with the track. Images without the target, outliers
            and clutter do not count.
        front_probability: probability that the target is in the front hemisphere.
        resolved: whether the hemisphere is resolved.
        requested_rotation (rad): rotation of the body that would resolve it.
        look (rad): azimuth and elevation in the body's frame where a look of the camera decides most; None where none is
            requested.
        sound_confidence, sight_confidence: confidence of the newest direction of arrival, score of the newest detection, 0..1;
            0 where these are too old.
        sound_weight, sight_weight: shares of the microphones and of the camera in the bearing, 0..1.
        visibility: visibility of the scene, 0..1; NaN where it is unknown.
    """

    time: float
    state: State = State.NONE
    reason: str = 'no measurement yet'
    changed: float = 0.0
    source: Source = Source.NOTHING
    azimuth: float = math.nan
    elevation: float = 0.0
    azimuth_variance: float = math.inf
    elevation_variance: float = math.inf
    azimuth_world: float = math.nan
    azimuth_world_rate: float = 0.0
    elevation_world: float = 0.0
    elevation_world_rate: float = 0.0
    covariance_world: tuple[float, float, float, float] = (math.inf, 0.0, 0.0, math.inf)
    attitude_known: bool = False
    range: float = math.nan
    range_variance: float = math.inf
    measured: float = 0.0
    front_probability: float = 0.5
    resolved: bool = False
    requested_rotation: float = 0.0
    look: tuple[float, float] | None = None
    sound_confidence: float = 0.0
    sight_confidence: float = 0.0
    sound_weight: float = 0.0
    sight_weight: float = 0.0
    visibility: float = math.nan

    @property
    def hemisphere_probability(self) -> float:
        """Probability 0.5..1 that the bearing is in the correct hemisphere, front or back."""
        return max(self.front_probability, 1.0 - self.front_probability)


class Target(NamedTuple):
    """One of several targets.

    Parameters:
        id: stays with the target as long as its track lives, from 1; ids are not used again.
        existence: probability 0..1 that there is such a target.
        track: where it is.
        drone_probability: probability 0..1 that it is a drone; NaN while unknown.
        heard, seen (s): capture times of its newest direction of arrival and detection; -inf for never.
        kind: most probable class or type of drone; empty while unknown.
        fundamental (Hz): blade-pass frequency of its sound; NaN while unknown.
        on_rig: probability that it is fixed to the body, as the rig's own rotors are.
    """

    id: int
    existence: float
    track: Track
    drone_probability: float = math.nan
    heard: float = -math.inf
    seen: float = -math.inf
    kind: str = ''
    fundamental: float = math.nan
    on_rig: float = 0.0


class Targets(NamedTuple):
    """All targets that are tracked at `time` (s), by id, and the id of the one that is followed; 0 for none."""

    time: float
    targets: tuple[Target, ...] = ()
    selected: int = 0
