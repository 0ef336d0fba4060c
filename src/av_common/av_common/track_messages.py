"""Conversions between `Track` and the messages that carry it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from std_msgs.msg import Header

from av_common.stamps import to_seconds, to_stamp
from av_common.track import DRONE, Source, State, Target, Targets, Track
from av_interfaces.msg import Bearing, FusionState, TrackArray
from av_interfaces.msg import Track as TrackMessage


def bearing_message(track: Track, frame_id: str) -> Bearing:
    """The `Bearing` of a track, valid at the track's time, in the body frame `frame_id`.

    Parameters:
        track: the estimate.
        frame_id: frame of the rig's body.
    """
    look = track.look or (math.nan, math.nan)
    known = track.state != State.NONE and track.measured > 0.0
    return Bearing(
        header=Header(stamp=to_stamp(track.time), frame_id=frame_id), azimuth=track.azimuth, elevation=track.elevation,
        azimuth_variance=track.azimuth_variance, elevation_variance=track.elevation_variance,
        azimuth_world=track.azimuth_world, azimuth_world_rate=track.azimuth_world_rate,
        elevation_world=track.elevation_world, elevation_world_rate=track.elevation_world_rate,
        covariance_world=np.array(track.covariance_world, np.float32), attitude_known=track.attitude_known, range=track.range,
        range_variance=track.range_variance, look_requested=track.look is not None, look_azimuth=look[0],
        look_elevation=look[1], state=int(track.state), source=int(track.source),
        hemisphere_probability=track.hemisphere_probability, resolved=track.resolved,
        requested_rotation=track.requested_rotation, measured=to_stamp(track.measured if known else 0.0))


def state_message(track: Track, missing: Sequence[str], frame_id: str) -> FusionState:
    """The `FusionState` of a track; `missing` names the inputs without recent messages.

    Parameters:
        track: the estimate.
        missing: names of the inputs without recent messages.
        frame_id: frame of the rig's body.
    """
    return FusionState(
        header=Header(stamp=to_stamp(track.time), frame_id=frame_id), state=int(track.state), reason=track.reason,
        changed=to_stamp(max(track.changed, 0.0)), sound_confidence=track.sound_confidence,
        sight_confidence=track.sight_confidence, sound_weight=track.sound_weight, sight_weight=track.sight_weight,
        visibility=track.visibility, front_probability=track.front_probability, missing=list(missing))


def targets_message(targets: Targets, frame_id: str) -> TrackArray:
    """The `TrackArray` of all targets.

    Parameters:
        targets: the targets.
        frame_id: frame of the rig's body.
    """
    return TrackArray(header=Header(stamp=to_stamp(targets.time), frame_id=frame_id), selected=targets.selected,
                      tracks=[_track_message(target) for target in targets.targets])


def _track_message(target: Target) -> TrackMessage:
    track = target.track
    return TrackMessage(
        id=target.id, existence=target.existence, drone_probability=target.drone_probability,
        fundamental=target.fundamental, class_id=target.kind or (DRONE if target.drone_probability >= 0.5 else ''),
        azimuth=track.azimuth, elevation=track.elevation, azimuth_world=track.azimuth_world,
        azimuth_world_rate=track.azimuth_world_rate,
        elevation_world=track.elevation_world, elevation_world_rate=track.elevation_world_rate,
        covariance_world=np.array(track.covariance_world, np.float32), range=track.range, range_variance=track.range_variance,
        source=int(track.source), hemisphere_probability=track.hemisphere_probability, resolved=track.resolved,
        last_heard=to_stamp(max(target.heard, 0.0)), last_seen=to_stamp(max(target.seen, 0.0)))


def track_of_bearing(message: Any) -> Track:
    """The part of a track that a `Bearing` carries. Values of `state` that are not defined count as COASTING."""
    return Track(
        time=to_seconds(message.header.stamp), state=State(min(message.state, max(State))),
        source=Source(message.source & int(Source.SOUND | Source.SIGHT)), azimuth=message.azimuth,
        elevation=message.elevation, azimuth_variance=message.azimuth_variance,
        elevation_variance=message.elevation_variance, azimuth_world=message.azimuth_world,
        azimuth_world_rate=message.azimuth_world_rate, elevation_world=message.elevation_world,
        elevation_world_rate=message.elevation_world_rate, covariance_world=_four(message.covariance_world),
        attitude_known=message.attitude_known, range=message.range, range_variance=message.range_variance,
        look=(message.look_azimuth, message.look_elevation) if message.look_requested else None,
        measured=to_seconds(message.measured),
        resolved=message.resolved, requested_rotation=message.requested_rotation)


def _four(values: Any) -> tuple[float, float, float, float]:
    a, b, c, d = map(float, values)
    return a, b, c, d
