"""Plain data of the rig's messages."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from sensor_msgs.msg import NavSatFix, NavSatStatus

from av_common.geodesy import enu_axes, enu_to_geodetic
from av_common.stamps import to_seconds
from av_interfaces.msg import Track, TrackArray, WorldTrack, WorldTrackArray
from av_reports.contacts import BearingTrack, Place, PositionTrack

STEEPEST = 0.02  # cosine of an elevation, above which an azimuth has no standard deviation to speak of
LARGEST = 1e12  # m, m^2, m/s: larger ones say nothing, and make events of Cursor on Target longer than a datagram
LONGEST_NAME = 64  # characters of a class


def bearing_tracks(message: TrackArray, heading: float | None, north: bool) -> Iterator[BearingTrack]:
    """The targets of a single rig whose direction is known.

    Parameters:
        message: of the topic `targets`.
        heading (rad): true heading of the rig's forward direction, clockwise from north, where its attitude is not known;
            None where the directions in the world are those of its attitude.
        north: count from true north; otherwise from the rig's forward direction.

    Raises ValueError for stamps that cannot be used.
    """
    time = to_seconds(message.header.stamp)
    for track in message.tracks:
        variance, azimuth = float(track.covariance_world[0]), _azimuth(track, heading, north)
        if not (math.isfinite(azimuth) and math.isfinite(variance) and variance >= 0.0 and math.isfinite(track.existence)):
            continue
        measured = max(to_seconds(track.last_heard), to_seconds(track.last_seen))
        elevation, elevation_variance = float(track.elevation_world), float(track.covariance_world[3])
        known = abs(elevation) <= math.pi / 2 + 1e-3 and 0.0 <= elevation_variance < math.inf
        steepness = max(math.cos(elevation), STEEPEST) if known else 1.0
        yield BearingTrack(
            id=track.id, time=time, measured=measured, existence=min(max(track.existence, 0.0), 1.0),
            azimuth=azimuth % math.tau,
            azimuth_sigma=min(math.sqrt(variance) / steepness, math.pi), elevation=elevation if known else math.nan,
            elevation_sigma=math.sqrt(elevation_variance) if known else math.nan, north=north,
            front_back=_probability(track.hemisphere_probability, 0.5), resolved=track.resolved,
            drone_probability=_probability(track.drone_probability), class_id=track.class_id[:LONGEST_NAME])


def _azimuth(track: Track, heading: float | None, north: bool) -> float:
    """Azimuth (rad) clockwise; those of messages count counter-clockwise."""
    if not north:
        return -float(track.azimuth)
    return math.pi / 2 - float(track.azimuth_world) if heading is None else heading - float(track.azimuth)


def position_tracks(message: WorldTrackArray) -> Iterator[PositionTrack]:
    """The targets of a network of rigs whose position is known; what is meaningless is left out.

    Parameters:
        message: of the topic `tracks`.

    Raises ValueError for stamps that cannot be used, and where the frame's origin has no place on the earth.
    """
    time = to_seconds(message.header.stamp)
    origin = (message.latitude, message.longitude, message.altitude)
    if not _is_place(*origin):
        raise ValueError(f'the origin of {message.header.frame_id!r} is at {origin}, expected latitude, longitude and altitude')
    for track in message.tracks:
        numbers = _numbers(track)
        usable = (np.abs(numbers[:15]) < LARGEST).all() and math.isfinite(track.existence) and _is_covariance(numbers[3:12])
        if track.positioned and usable:
            yield _position_track(track, numbers, origin, time)


def place_of_fix(message: NavSatFix) -> Place:
    """Where a receiver of satellite navigation is. Raises ValueError for a message without a fix."""
    numbers = (message.latitude, message.longitude, message.altitude)
    if message.status.status < NavSatStatus.STATUS_FIX or not _is_place(*numbers):
        raise ValueError(f'no fix: status {message.status.status}, {numbers}')
    known = message.position_covariance_type != NavSatFix.COVARIANCE_TYPE_UNKNOWN and message.position_covariance[0] >= 0.0
    return Place(*numbers, math.sqrt(message.position_covariance[0]) if known else math.nan, surveyed=False)


def _is_place(latitude: float, longitude: float, altitude: float) -> bool:
    """Whether there is such a place on the earth, or above it."""
    return abs(latitude) <= 90.0 and abs(longitude) <= 360.0 and abs(altitude) < LARGEST


def _probability(value: float, otherwise: float = math.nan) -> float:
    """A probability; `otherwise` for a number that is none."""
    return value if 0.0 <= value <= 1.0 else otherwise


def _numbers(track: WorldTrack) -> np.ndarray:
    """Position, covariance of the position, velocity and its variances, (18,)."""
    where, speed = track.position, track.velocity
    return np.array([where.x, where.y, where.z, *track.position_covariance, speed.x, speed.y, speed.z,
                     *track.velocity_covariance[::4]])


def _is_covariance(values: np.ndarray) -> bool:
    """Whether nine numbers are a covariance, but for rounding."""
    matrix = values.reshape(3, 3)
    return bool(np.allclose(matrix, matrix.T) and np.linalg.eigvalsh(matrix)[0] >= -1e-6 * np.trace(matrix))


def _position_track(track: WorldTrack, numbers: np.ndarray, origin: tuple[float, float, float], time: float) -> PositionTrack:
    """A track in the axes of its own place, which differ from those of the origin where that is far away."""
    latitude, longitude, altitude = enu_to_geodetic(numbers[:3], origin)
    turn = enu_axes(latitude, longitude) @ enu_axes(*origin[:2]).T
    covariance = turn @ numbers[3:12].reshape(3, 3) @ turn.T
    east, north, up = turn @ numbers[12:15]
    return PositionTrack(
        id=track.id, time=time, measured=to_seconds(track.measured), existence=min(max(track.existence, 0.0), 1.0),
        latitude=latitude, longitude=longitude, altitude=altitude,
        covariance=tuple(map(tuple, covariance.tolist())), velocity=(east, north, up),
        velocity_sigma=tuple(np.sqrt(np.where(numbers[15:] >= 0.0, numbers[15:], math.inf)).tolist()),
        drone_probability=_probability(track.drone_probability), class_id=track.class_id[:LONGEST_NAME])
