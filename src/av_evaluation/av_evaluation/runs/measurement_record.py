"""The measurements of a run in order of arrival, so that other trackers and methods get the same data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, cast

from av_common.track import Track
from av_evaluation.metrics.run_log import Event, RunLog, Series
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement, usable_doas
from av_fusion.measurement.rig_motion import Pose
from av_fusion.settings import Tracker

OWN_METHOD = 'ml'  # the rig's own estimator of directions


def repeat(events: Sequence[Event], tracker: Tracker) -> Series:
    """Give another tracker the events of a run; its bearings as a series like `RunLog.fused`."""
    series = RunLog().fused
    for event in events:
        if isinstance(event, CameraMeasurement):
            tracker.add_camera(event)
        elif isinstance(event, Pose):
            tracker.add_pose(event)
        elif isinstance(event, list):
            tracker.add_doas(event)
        else:
            track = tracker.estimate(event)
            series.add(event, track.azimuth, math.sqrt(track.azimuth_variance), track.state, track.resolved,
                       event - track.measured)
    return series


def with_directions(events: Sequence[Event], directions: Sequence[DoaMeasurement]) -> list[Event]:
    """Events with other directions of arrival in the place of the rig's own, each where its window ends."""
    waiting = sorted(usable_doas(directions), key=_end, reverse=True)
    found: list[Event] = []
    for event in events:
        if isinstance(event, list):
            continue
        while waiting and _end(waiting[-1]) <= (event if isinstance(event, float) else event.time):
            found.append([waiting.pop()])
        found.append(event)
    return [*found, *([one] for one in reversed(waiting))]


def _end(measurement: DoaMeasurement) -> float:
    """End (s) of a measurement's window."""
    return measurement.time + 0.5 * measurement.window


class _RecordingTracker:
    """A tracker whose input is recorded before another one uses it, which does all else."""

    def __init__(self, tracker: Tracker, events: list[Event]) -> None:
        self._tracker, self._events = tracker, events

    def __getattr__(self, name: str) -> Any:
        return getattr(self._tracker, name)

    def add_pose(self, pose: Pose) -> None:
        self._events.append(pose)
        self._tracker.add_pose(pose)

    def add_doas(self, measurements: Sequence[DoaMeasurement]) -> None:
        self._events.append(list(measurements))
        self._tracker.add_doas(measurements)

    def add_camera(self, measurement: CameraMeasurement) -> None:
        self._events.append(measurement)
        self._tracker.add_camera(measurement)

    def estimate(self, time: float) -> Track:
        self._events.append(time)
        return self._tracker.estimate(time)


def recording(tracker: Tracker, events: list[Event]) -> Tracker:
    """A tracker that adds its input to events, and passes it on to another one."""
    return cast('Tracker', _RecordingTracker(tracker, events))
