"""What the senses told a tracker in a run, so that other trackers can be given the very same."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from av_common.track import Track
from av_evaluation.metrics.run_log import RunLog, Series
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement


@dataclass
class Recording:
    """What was told in order of arrival.

    `sounds` by estimator ('ml' is the rig's own); `events` are poses (time, yaw, rate), the rig's own sounds, looks, and
    the times (float) at which a bearing was asked for.
    """

    sounds: dict[str, list[DoaMeasurement]] = field(default_factory=dict)
    events: list[tuple[float, float, float] | DoaMeasurement | CameraMeasurement | float] = field(default_factory=list)

    def feed(self, tracker: Any) -> Series:
        """Give another tracker the same events; its bearings as a series like `RunLog.fused`."""
        series = RunLog().fused
        for event in self.events:
            if isinstance(event, DoaMeasurement):
                tracker.add_doa(event)
            elif isinstance(event, CameraMeasurement):
                tracker.add_camera(event)
            elif isinstance(event, tuple):
                tracker.add_pose(*event)
            else:
                track = tracker.estimate(event)
                series.add(event, track.azimuth, math.sqrt(track.azimuth_variance), track.state, track.resolved,
                           event - track.measured)
        return series


class RecordingTracker:
    """A tracker that notes down what it is told before it passes it on."""

    def __init__(self, tracker: Any, recording: Recording) -> None:
        self._tracker, self._events = tracker, recording.events

    def add_pose(self, time: float, yaw: float, yaw_rate: float = 0.0) -> None:
        """See `BayesTracker`."""
        self._events.append((time, yaw, yaw_rate))
        self._tracker.add_pose(time, yaw, yaw_rate)

    def add_doa(self, measurement: DoaMeasurement) -> None:
        """See `BayesTracker`."""
        self._events.append(measurement)
        self._tracker.add_doa(measurement)

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """See `BayesTracker`."""
        self._events.append(measurement)
        self._tracker.add_camera(measurement)

    def reset(self) -> None:
        """See `BayesTracker`."""
        self._tracker.reset()

    def diagnostics(self) -> dict[str, str]:
        """See `BayesTracker`."""
        return self._tracker.diagnostics()

    def estimate(self, time: float) -> Track:
        """See `BayesTracker`."""
        self._events.append(time)
        return self._tracker.estimate(time)
