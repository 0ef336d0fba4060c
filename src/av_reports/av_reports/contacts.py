"""What is reported of a target, as plain data: a bearing by a single rig, or a position by a network; what others may ask."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

LIKELY = 0.5  # from this probability on something is what it may be
LOST_S = 2.0  # since its newest measurement, after which a target is not reported: as long as a gimbal follows a prediction
SENSOR_RANGE_M = 500.0  # length of a drawn bearing; that of the target is not known


def compass_deg(azimuth: float, digits: int = 9) -> float:
    """An azimuth (rad) in degrees from 0 on and below 360, rounded: due north is 0.0, and not 360.0."""
    return round(math.degrees(azimuth) % 360.0, digits) % 360.0


def is_due(now: float, last: float, period: float) -> bool:
    """Whether what was told `last` (s; -inf for never) is told again: after a period (s), or where the clock was set back."""
    return not 0.0 <= now - last < period


class BearingTrack(NamedTuple):
    """A target of which a single rig knows the direction, and no distance.

    Parameters:
        id: stays with the target as long as its track lives.
        time (s): instant for which the direction holds, UTC since 1970.
        measured (s): the same of the newest measurement associated with the track; 0 for never.
        existence, drone_probability: probabilities 0..1; the second one is NaN while unknown.
        class_id: most probable class; empty while unknown.
        azimuth (rad): clockwise from true north, or from the rig's forward direction without `north`; in [0, 2 pi).
        azimuth_sigma (rad): standard deviation.
        elevation, elevation_sigma (rad): up from the horizontal plane; NaN while unknown.
        north: whether the azimuth counts from true north.
        front_back: probability 0.5..1 that the direction is in the correct hemisphere, front or back.
        resolved: front and back are resolved.
    """

    id: int
    time: float
    measured: float
    existence: float
    azimuth: float
    azimuth_sigma: float
    elevation: float = math.nan
    elevation_sigma: float = math.nan
    north: bool = True
    front_back: float = 1.0
    resolved: bool = True
    drone_probability: float = math.nan
    class_id: str = ''


class PositionTrack(NamedTuple):
    """A target of which several rigs know the position.

    Parameters:
        id, time, measured, existence, drone_probability, class_id: as of `BearingTrack`.
        latitude, longitude (deg), altitude (m): WGS84, above its ellipsoid.
        covariance (m^2): of east, north and up, three rows.
        velocity (m/s): east, north, up.
        velocity_sigma (m/s): standard deviations of the three.
    """

    id: int
    time: float
    measured: float
    existence: float
    latitude: float
    longitude: float
    altitude: float
    covariance: tuple[tuple[float, float, float], ...]
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    velocity_sigma: tuple[float, float, float] = (math.inf, math.inf, math.inf)
    drone_probability: float = math.nan
    class_id: str = ''

    @property
    def sigma(self) -> tuple[float, float, float]:
        """Standard deviations (m) to the east, north and up."""
        east, north, up = (math.sqrt(max(self.covariance[axis][axis], 0.0)) for axis in range(3))
        return east, north, up


def later(track: BearingTrack | PositionTrack, seconds: float) -> BearingTrack | PositionTrack:
    """A target as it is by a clock that is ahead by some time (s); one that was never measured stays so."""
    measured = track.measured + seconds if track.measured else 0.0
    return track._replace(time=track.time + seconds, measured=measured)


class Place(NamedTuple):
    """Where a rig stands.

    Parameters:
        latitude, longitude (deg), altitude (m): WGS84, above its ellipsoid.
        sigma (m): standard deviation.
        surveyed: whether it was given by a person, rather than measured.
    """

    latitude: float
    longitude: float
    altitude: float
    sigma: float = math.nan
    surveyed: bool = True


def is_reported(track: BearingTrack | PositionTrack, now: float, only_drones: bool = True) -> bool:
    """Whether a target is reported: likely, lately measured, and of a known side; one of which it is not known may be a drone.

    Parameters:
        track: the target.
        now (s): UTC since 1970.
        only_drones: those that are probably none are left out.
    """
    return (track.existence >= LIKELY and abs(now - track.measured) <= LOST_S
            and not (only_drones and track.drone_probability < LIKELY)
            and not (isinstance(track, BearingTrack) and not track.resolved))


@dataclass(frozen=True)
class Follow:
    """The rig is to follow the track `id`."""

    id: int


@dataclass(frozen=True)
class LookAt:
    """The rig is to look in a direction.

    Parameters:
        azimuth (rad): clockwise, from true north or from the rig's forward direction.
        elevation (rad): up from the horizontal plane.
        north: whether the azimuth counts from true north.
    """

    azimuth: float
    elevation: float
    north: bool


@dataclass(frozen=True)
class Stop:
    """The rig is to do again what it did without a task."""


Command = Follow | LookAt | Stop
