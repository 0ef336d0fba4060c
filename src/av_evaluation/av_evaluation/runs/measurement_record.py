"""The measurements of a run in order of arrival, so that other trackers and methods get the same data."""

from __future__ import annotations

import math
from collections.abc import Sequence

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
