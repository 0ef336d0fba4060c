"""Plain data of the rig's messages."""

from __future__ import annotations

import math
from collections.abc import Iterator

from av_common.stamps import to_seconds
from av_interfaces.msg import Track, TrackArray
from av_reports.contacts import BearingTrack

STEEPEST = 0.02  # cosine of an elevation, above which an azimuth has no standard deviation to speak of


def bearing_tracks(message: TrackArray, heading: float | None, north: bool, to_utc: float = 0.0) -> Iterator[BearingTrack]:
    """The targets of a single rig whose direction is known.

    Parameters:
        message: of the topic `targets`.
        heading (rad): true heading of the rig's forward direction, clockwise from north, where its attitude is not known;
            None where the directions in the world are those of its attitude.
        north: count from true north; otherwise from the rig's forward direction.
        to_utc (s): what is to be added to ROS time for UTC.

    Raises ValueError for stamps that cannot be used.
    """
    time = to_seconds(message.header.stamp)
    for track in message.tracks:
        variance, azimuth = float(track.covariance_world[0]), _azimuth(track, heading, north)
        if not (math.isfinite(azimuth) and math.isfinite(variance) and variance >= 0.0 and math.isfinite(track.existence)):
            continue
        measured = max(to_seconds(track.last_heard), to_seconds(track.last_seen))
        elevation, elevation_variance = float(track.elevation_world), float(track.covariance_world[3])
        known = math.isfinite(elevation) and 0.0 <= elevation_variance < math.inf
        steepness = max(math.cos(elevation), STEEPEST) if known else 1.0
        yield BearingTrack(
            id=track.id, time=time + to_utc, measured=measured + to_utc if measured else 0.0,
            existence=min(max(track.existence, 0.0), 1.0), azimuth=azimuth % math.tau,
            azimuth_sigma=min(math.sqrt(variance) / steepness, math.pi), elevation=elevation if known else math.nan,
            elevation_sigma=math.sqrt(elevation_variance) if known else math.nan, north=north,
            front_back=track.hemisphere_probability, resolved=track.resolved, drone_probability=track.drone_probability,
            class_id=track.class_id, selected=track.id == message.selected)


def _azimuth(track: Track, heading: float | None, north: bool) -> float:
    """Azimuth (rad) clockwise; those of messages count counter-clockwise."""
    if not north:
        return -float(track.azimuth)
    return math.pi / 2 - float(track.azimuth_world) if heading is None else heading - float(track.azimuth)
