"""What a rig tells other rigs of its targets: few bytes, a few times a second."""

from __future__ import annotations

import math

import numpy as np

from av_common.stamps import to_seconds
from av_common.track import Source
from av_fusion.measurement.vectors import Vector
from av_interfaces.msg import RigReport, TargetDirection, Track, TrackArray

UNKNOWN: Vector = (math.nan, math.nan, math.nan)
COUNTED = 256  # from which on measurements are counted anew


class RigReporter:
    """Thins a rig's targets out to reports for other rigs, and counts the measurements that these rest on.

    A track that is seen rests on what is seen of it, which is far more precise than sound. Measurements of which no targets
    tell, as of frames between two messages, are not counted.

    Parameters:
        rate (Hz): most reports a second.
    """

    def __init__(self, rate: float) -> None:
        self._period = 1.0 / rate
        self._last = -math.inf
        self._counted: dict[int, tuple[float, int]] = {}  # newest measurement (s) of each track, and their number

    def report(self, targets: TrackArray, position: Vector | None) -> RigReport | None:
        """The report of these targets; None soon after the last one.

        Parameters:
            targets: of the rig, all that it publishes.
            position (m): of the rig by its odometry; None while unknown.
        """
        stamp = to_seconds(targets.header.stamp)
        self._counted = {track.id: self._count(track) for track in targets.tracks}
        if 0.0 <= stamp - self._last < self._period:
            return None
        self._last = stamp
        return RigReport(header=targets.header, position=np.array(position or UNKNOWN, np.float32),
                         directions=[_direction(track, self._counted[track.id][1]) for track in targets.tracks])

    def _count(self, track: Track) -> tuple[float, int]:
        newest, count = self._counted.get(track.id, (0.0, 0))
        measured = to_seconds(track.last_seen if _is_seen(track) else track.last_heard)
        return measured, (count + (measured != newest)) % COUNTED


def _is_seen(track: Track) -> bool:
    return bool(track.source & int(Source.SIGHT))


def _direction(track: Track, measurements: int) -> TargetDirection:
    horizontal, both, _, vertical = map(float, track.covariance_world)
    measured = max(track.last_heard, track.last_seen, key=to_seconds)
    return TargetDirection(
        id=track.id, azimuth=track.azimuth_world, elevation=track.elevation_world,
        covariance=np.array([horizontal, both, vertical], np.float32), measured=measured, existence=track.existence,
        drone_probability=track.drone_probability, seen=_is_seen(track), measurements=measurements, resolved=track.resolved,
        class_id=track.class_id)
