"""Results of a replay for tables and figures: the same columns as the monitor's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from av_bags import topics as names
from av_common.frames import attitude_of, is_orientation
from av_common.stamps import to_seconds
from av_common.track import State, Track
from av_evaluation.experiments.methods import OWN_METHOD
from av_evaluation.metrics.run_log import Event, RunLog
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement, usable_doas
from av_fusion.measurement.rig_motion import Pose

LARGEST_OFFSET_S = 60.0    # of a stamp from its arrival: the figures take memory by the log's span of time


class RunRecorder:
    """An observer of a `FusionStage` that writes a `RunLog`. Delays are in the time of the arrivals: computing takes none.

    Raises ValueError for what is stamped by another clock.

    Attributes:
        log: measurements, tracks and true poses.
        left_out (s): time between segments of a bag, which is left out of the times of the log.

    Parameters:
        folder: for temporary files of the log, as for `RunLog`; without one the log also has the directions by estimator.
        keeps_events: whether the log gets what the tracker is given, for other trackers.
    """

    def __init__(self, folder: Path | None = None, keeps_events: bool = False) -> None:
        self.log, self._keeps, self._keeps_events = RunLog(folder), folder is None, keeps_events
        self.left_out = 0.0

    def on_pose(self, pose: Pose) -> None:
        """Keep a pose."""
        self._keep(pose._replace(time=pose.time - self.left_out))

    def on_doa(self, measurements: Sequence[DoaMeasurement], arrival: float) -> None:
        """Log the most confident measurement of a window."""
        logged = [doa._replace(time=self._time(doa.time, arrival)) for doa in measurements]
        self._keep(usable_doas(logged))
        if self._keeps:
            self.log.doa.setdefault(OWN_METHOD, []).extend(logged[:1])
        for doa in logged[:1]:
            azimuths = [hypothesis.azimuth for hypothesis in doa.hypotheses]
            self.log.sound.add(doa.time, azimuths[0], azimuths[1] if len(azimuths) > 1 else math.nan, doa.confidence,
                               arrival - self.left_out - doa.time)

    def on_other(self, method: str, measurements: Sequence[DoaMeasurement], arrival: float) -> None:
        """Log the most confident measurement of a window by another method."""
        self.log.doa.setdefault(method, []).extend(
            doa._replace(time=self._time(doa.time, arrival)) for doa in measurements[:1])

    def on_camera(self, measurement: CameraMeasurement, message: Any, arrival: float) -> None:
        """Log the best detection. Detections whose names begin with 'oracle' are the simulator's."""
        measurement = measurement._replace(time=self._time(measurement.time, arrival))
        self._keep(measurement)
        best = measurement.best
        self.log.sight.add(measurement.time, best.azimuth if best else math.nan, best.score if best else 0.0,
                           arrival - self.left_out - measurement.time)
        if any(detection.id.startswith('oracle') for detection in message.detections):
            self.log.notes['detections'] = "the simulator's visual oracle (no detector ran)"

    def on_track(self, track: Track, time: float) -> None:
        """Log the track at `time` (s)."""
        self._keep(time - self.left_out)
        known = track.state != State.NONE
        self.log.fused.add(self._time(track.time, time), track.azimuth, math.sqrt(track.azimuth_variance), track.state,
                           track.resolved, time - track.measured if known else math.nan)

    def on_truth(self, name: str, odometry: Any, arrival: float) -> None:
        """Log a true pose.

        Parameters:
            name: of its topic: TRUE_TARGET or TRUE_RIG of `av_bags.topics`.
            odometry: the message.
            arrival (s): its time.

        Raises ValueError for a pose that is none, too.
        """
        time, position = self._time(to_seconds(odometry.header.stamp), arrival), odometry.pose.pose.position
        place, attitude = (position.x, position.y, position.z), attitude_of(odometry.pose.pose.orientation)
        if not all(map(math.isfinite, place)):
            raise ValueError(f'the position is {place}, expected finite numbers')
        if name == names.TRUE_TARGET:
            self.log.target.add(time, *place)
        elif is_orientation(attitude):
            self.log.rig.add(time, *place, *attitude)
        else:
            raise ValueError(f'the orientation (w, x, y, z) is {attitude}, expected a unit quaternion')

    def _time(self, stamp: float, arrival: float) -> float:
        """Time (s) in the log of what is stamped `stamp` (s)."""
        if not abs(stamp - arrival) <= LARGEST_OFFSET_S:
            raise ValueError(f'stamp is more than {LARGEST_OFFSET_S:g} s off the clock')
        return stamp - self.left_out

    def _keep(self, event: Event) -> None:
        if self._keeps_events:
            self.log.events.append(event)
