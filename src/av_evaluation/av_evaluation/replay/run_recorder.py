"""What a replay finds, for tables and pictures: the same columns as the monitor's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from av_bags import topics as names
from av_common.frames import yaw_of
from av_common.stamps import to_seconds
from av_common.track import State, Track
from av_evaluation.metrics.run_log import RunLog
from av_evaluation.runs.recording import Recording
from av_fusion.measurement.measurements import Look, Sound


class Journal:
    """Writes a RunLog. Delays are in the bag's time: computing takes none."""

    def __init__(self, recording: Recording | None = None) -> None:
        """`recording` gets the sounds, too."""
        self.log, self._recording = RunLog(), recording

    def hear(self, sounds: Sequence[Sound], now: float) -> None:
        """The strongest of the sounds of one window."""
        if self._recording is not None:
            self._recording.sounds.setdefault('ml', []).extend(sounds[:1])
        for sound in sounds[:1]:
            azimuths = [hypothesis.azimuth for hypothesis in sound.hypotheses]
            self.log.sound.add(sound.time, azimuths[0], azimuths[1] if len(azimuths) > 1 else math.nan,
                               sound.confidence, now - sound.time - 0.5 * sound.window)

    def see(self, look: Look, message: Any, now: float) -> None:
        """A picture's best detection; the names of the boxes tell who detected."""
        best = look.best
        self.log.sight.add(look.time, best.azimuth if best else math.nan, best.confidence if best else 0.0,
                           now - look.time)
        if any(detection.id.startswith('oracle') for detection in message.detections):
            self.log.notes['detections'] = "the simulator's visual oracle (no detector ran)"

    def follow(self, track: Track, now: float) -> None:
        """A bearing."""
        known = track.state != State.NONE
        self.log.fused.add(track.time, track.azimuth, math.sqrt(track.azimuth_variance), track.state, track.resolved,
                           now - track.measured if known else math.nan)

    def know(self, name: str, odometry: Any) -> None:
        """The true pose of target or rig."""
        time, position, q = to_seconds(odometry.header.stamp), odometry.pose.pose.position, odometry.pose.pose.orientation
        if name == names.TRUE_TARGET:
            self.log.target.add(time, position.x, position.y, position.z)
        else:
            self.log.rig.add(time, position.x, position.y, position.z, yaw_of((q.w, q.x, q.y, q.z)))
