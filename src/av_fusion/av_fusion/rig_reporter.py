"""What a rig tells other rigs of its targets: few bytes, a few times a second."""

from __future__ import annotations

import math

import numpy as np

from av_common.stamps import to_seconds
from av_common.track import Source
from av_fusion.measurement.vectors import Vector
from av_interfaces.msg import RigReport, TargetDirection, Track, TrackArray

UNKNOWN: Vector = (math.nan, math.nan, math.nan)


class RigReporter:
    """Thins a rig's targets out to reports for other rigs.

    Parameters:
        rate (Hz): most reports a second.
    """

    def __init__(self, rate: float) -> None:
        self._period = 1.0 / rate
        self._last = -math.inf

    def report(self, targets: TrackArray, position: Vector | None) -> RigReport | None:
        """The report of these targets; None soon after the last one.

        Parameters:
            targets: of the rig.
            position (m): of the rig by its odometry; None while unknown.
        """
        stamp = to_seconds(targets.header.stamp)
        if 0.0 <= stamp - self._last < self._period:
            return None
        self._last = stamp
        return RigReport(header=targets.header, position=np.array(position or UNKNOWN, np.float32),
                         directions=[_direction(track) for track in targets.tracks])


def _direction(track: Track) -> TargetDirection:
    horizontal, both, _, vertical = map(float, track.covariance_world)
    measured = max(track.last_heard, track.last_seen, key=to_seconds)
    return TargetDirection(
        id=track.id, azimuth=track.azimuth_world, elevation=track.elevation_world,
        covariance=np.array([horizontal, both, vertical], np.float32), measured=measured, existence=track.existence,
        drone_probability=track.drone_probability, seen=bool(track.source & int(Source.SIGHT)), resolved=track.resolved,
        class_id=track.class_id)
