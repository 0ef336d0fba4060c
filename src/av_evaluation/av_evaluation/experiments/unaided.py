"""What hearing alone says with nobody's help: the mirror image by the published rules, at the instant at which it is said."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from av_evaluation.runs.measurement_record import MeasurementRecord
from av_fusion.baseline.gated_tracker import GatedSettings, GatedTracker
from av_fusion.filter.state_machine import MachineSettings
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement


def chosen_images(sounds: Sequence[DoaMeasurement], record: MeasurementRecord, tau: float) -> tuple[NDArray, NDArray]:
    """Ends of the windows of `sounds` (n,) in s, and of each the image (n,) that the published controller would take.

    Azimuths in rad in the world frame. The controller gets the run's poses and pictures and these sounds instead of its own:
    what was seen, what was heard before and what the rig's turns showed decide.
    """
    tracker = GatedTracker(GatedSettings(machine=MachineSettings(tau=tau)))
    waiting = sorted((sound for sound in sounds if sound.hypotheses), key=_end, reverse=True)
    times, azimuths = [], []

    def hear_until(now: float) -> None:
        while waiting and _end(waiting[-1]) <= now:
            sound = waiting.pop()
            tracker.add_doa(sound)
            if tracker.chosen_azimuth is not None:
                times.append(_end(sound))
                azimuths.append(tracker.chosen_azimuth)

    for event in record.events:
        if isinstance(event, DoaMeasurement):
            continue
        if isinstance(event, CameraMeasurement):
            hear_until(event.time)
            tracker.add_camera(event)
        elif isinstance(event, tuple):
            hear_until(event[0])
            tracker.add_pose(*event)
        else:
            hear_until(event)
    hear_until(math.inf)
    return np.array(times), np.array(azimuths)


def _end(sound: DoaMeasurement) -> float:
    return sound.time + 0.5 * sound.window
