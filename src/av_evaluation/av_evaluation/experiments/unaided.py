"""Bearings of sound alone without truth: the hypothesis that the published controller takes, at the time of its arrival."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from av_evaluation.runs.measurement_record import MeasurementRecord
from av_fusion.gated.tracker import GatedSettings, GatedTracker
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import Pose
from av_fusion.state_machine import MachineSettings


def chosen_hypotheses(measurements: Sequence[DoaMeasurement], record: MeasurementRecord,
                      tau: float) -> tuple[NDArray, NDArray]:
    """Ends of windows (n, s), and world azimuth (n, rad) of the hypothesis that the published controller takes in each.

    The controller uses the run's poses and camera measurements, with these directions in place of the run's own.

    Parameters:
        measurements: directions of arrival.
        record: measurements of the run.
        tau: gate on the score of detections.
    """
    tracker = GatedTracker(GatedSettings(machine=MachineSettings(tau=tau)))
    waiting = sorted((measurement for measurement in measurements if measurement.hypotheses), key=_end, reverse=True)
    times, azimuths = [], []

    def add_until(now: float) -> None:
        while waiting and _end(waiting[-1]) <= now:
            measurement = waiting.pop()
            tracker.add_doa(measurement)
            if tracker.chosen_azimuth is not None:
                times.append(_end(measurement))
                azimuths.append(tracker.chosen_azimuth)

    for event in record.events:
        if isinstance(event, DoaMeasurement):
            continue
        if isinstance(event, CameraMeasurement):
            add_until(event.time)
            tracker.add_camera(event)
        elif isinstance(event, Pose):
            add_until(event.time)
            tracker.add_pose(event)
        else:
            add_until(event)
    add_until(math.inf)
    return np.array(times), np.array(azimuths)


def _end(measurement: DoaMeasurement) -> float:
    """End (s) of a measurement's window."""
    return measurement.time + 0.5 * measurement.window
