"""What a rig tells other rigs of its targets: what it measured since its last report, a few times a second."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from std_msgs.msg import Header

from av_common.stamps import to_seconds, to_stamp
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import Vector, combined
from av_fusion.tracks.evidence import Increment
from av_fusion.tracks.track import Track as FilterTrack
from av_interfaces.msg import RigReport, TargetDirection, Track, TrackArray

# Nothing older than this comes later: half a window of sound (0.25 s), its processing, half of the time between two reports.
OLDEST_S = 0.6
REPORT_PERIOD_S = 0.25  # 1.2 to 2.2 kB/s, rigs agree within 0.4 s (docs/decisions.md)
UNKNOWN: Vector = (math.nan, math.nan, math.nan)


class RigReporter:
    """Collects what measurements add to a rig's tracks, for other rigs."""

    def __init__(self) -> None:
        self._last = -math.inf

    def report(self, targets: TrackArray, tracks: Sequence[FilterTrack], motion: RigMotion) -> RigReport | None:
        """The report of what was measured since the last one; None soon after that.

        Parameters:
            targets: of the rig.
            tracks: of its filter, whose measurements are taken.
            motion: of the rig.
        """
        now = to_seconds(targets.header.stamp)
        if 0.0 <= now - self._last < REPORT_PERIOD_S:
            return None
        self._last = now
        added = {track.id: track.increment() for track in tracks}
        found = [(track, each) for track in targets.tracks if (each := added.get(track.id)) is not None]
        newest = max((each.time for _, each in found), default=max(now - OLDEST_S, 0.0))
        position = UNKNOWN if motion.position is None else combined(1.0, motion.position, -1.0,
                                                                    motion.moved(newest, motion.newest))
        return RigReport(version=RigReport.VERSION, position=np.array(position, np.float32),
                         header=Header(stamp=to_stamp(newest), frame_id=targets.header.frame_id),
                         directions=[_direction(track, each) for track, each in found])


def _direction(track: Track, added: Increment) -> TargetDirection:
    return TargetDirection(
        id=track.id, azimuth=added.azimuth, elevation=added.elevation, measured=to_stamp(added.time), seen=added.seen,
        information=np.array([added.hh, added.hv, added.vv], np.float32), existence=track.existence,
        drone_probability=track.drone_probability, resolved=track.resolved, class_id=track.class_id)
