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
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement


class Journal:
    """Writes a RunLog. Delays are in the bag's time: computing takes none."""

    def __init__(self, recording: Recording | None = None) -> None:
        """`recording` gets the sounds, too."""
        self.log, self._recording = RunLog(), recording

    def on_doa(self, measurements: Sequence[DoaMeasurement], arrival: float) -> None:
        """See `FusionObserver`; the most confident measurement of a window is logged."""
        if self._recording is not None:
            self._recording.sounds.setdefault('ml', []).extend(measurements[:1])
        for doa in measurements[:1]:
            azimuths = [hypothesis.azimuth for hypothesis in doa.hypotheses]
            self.log.sound.add(doa.time, azimuths[0], azimuths[1] if len(azimuths) > 1 else math.nan,
                               doa.confidence, arrival - doa.time - 0.5 * doa.window)

    def on_camera(self, measurement: CameraMeasurement, message: Any, arrival: float) -> None:
        """See `FusionObserver`; the best detection is logged. Names of boxes tell a simulated detector."""
        best = measurement.best
        self.log.sight.add(measurement.time, best.azimuth if best else math.nan, best.confidence if best else 0.0,
                           arrival - measurement.time)
        if any(detection.id.startswith('oracle') for detection in message.detections):
            self.log.notes['detections'] = "the simulator's visual oracle (no detector ran)"

    def on_track(self, track: Track, time: float) -> None:
        """See `FusionObserver`."""
        known = track.state != State.NONE
        self.log.fused.add(track.time, track.azimuth, math.sqrt(track.azimuth_variance), track.state, track.resolved,
                           time - track.measured if known else math.nan)

    def know(self, name: str, odometry: Any) -> None:
        """The true pose of target or rig."""
        time, position, q = to_seconds(odometry.header.stamp), odometry.pose.pose.position, odometry.pose.pose.orientation
        if name == names.TRUE_TARGET:
            self.log.target.add(time, position.x, position.y, position.z)
        else:
            self.log.rig.add(time, position.x, position.y, position.z, yaw_of((q.w, q.x, q.y, q.z)))
