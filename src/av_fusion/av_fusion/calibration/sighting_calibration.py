"""Calibration of directions of arrival, and of further cameras, by what the first camera sees at the same time."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from av_common.rig import CAMERAS
from av_common.timeline import Timeline
from av_fusion.calibration.array_calibration import ArraySelfCalibration
from av_fusion.calibration.camera_alignment import CameraAlignment
from av_fusion.calibration.self_calibration import LEAST_CONFIDENCE, SelfCalibration
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import Rows, Vector, angles, combined, cross, direction, dot, turned, turned_back
from av_fusion.tracks.filter import effective_sample_fraction

AT_LIMIT = 'self-calibration at its limit'
LEAST_COMPARED_VARIANCE = 1e-5  # of a cosine that is compared with a sighting
MOST_WAITING = 100  # sightings of further cameras, some seconds of them
GAP_S, KEPT_S = 0.4, 3.0  # longest time between sightings that is interpolated, and age up to which they are kept


class Sighting(NamedTuple):
    """Direction of the target in the world.

    Parameters:
        time (s): capture time of the image.
        direction: unit vector.
        variance (rad^2): variance of the direction.
    """

    time: float
    direction: Vector
    variance: float


class SightingCalibration:
    """Compares directions of arrival with sightings of their time, and further cameras with the first one.

    Measurements are corrected by all comparisons so far: a bearing refers to the first camera as described.

    Attributes:
        array: what is known of the array.
        cameras: what is known of further cameras, by name.

    Parameters:
        enabled: whether they are compared at all.
        floor (rad): error of directions of arrival beyond what they report.
        motion: attitude of the rig.
    """

    def __init__(self, enabled: bool, floor: float, motion: RigMotion) -> None:
        self._enabled, self._floor, self._motion = enabled, floor, motion
        self.reset(learned=True)

    def reset(self, learned: bool = False) -> None:
        """Discard the sightings, and where `learned` what is known of array and cameras."""
        if learned:
            self.array = ArraySelfCalibration()
            self.cameras: dict[str, CameraAlignment] = {}
        self._sightings: Timeline[Sighting] = Timeline(KEPT_S)  # by the first camera, where it shows one thing
        self._others: deque[tuple[float, CameraMeasurement]] = deque(maxlen=MOST_WAITING)

    def turn_world(self, rows: Rows) -> None:
        """Turn the sightings with the world, where the rig's attitude was corrected."""
        self._sightings.change(lambda one: one._replace(direction=turned(rows, one.direction)))

    def align(self, time: float, measurement: CameraMeasurement, several: bool = False) -> CameraMeasurement:
        """Compare the images of further cameras with those of the first; returns an image corrected.

        What is compared is the only thing in each image: of several it is not known which is which.

        Parameters:
            time (s): capture time of the image.
            measurement: the image.
            several: whether several things were seen recently.
        """
        if not self._enabled:
            return measurement
        first = measurement.camera == CAMERAS[0]
        alignment = None if first else self.cameras.setdefault(measurement.camera, CameraAlignment())
        found = [one for one in measurement.detections if one.score >= LEAST_CONFIDENCE]
        if len(found) == 1 and not several:
            (one,) = found
            if not first:
                self._others.append((time, measurement._replace(detections=(one,))))
            elif time > self._sightings.newest:
                in_world = turned(self._motion.attitude(time), direction(one.azimuth, one.elevation))
                self._sightings.add(time, Sighting(time, in_world, one.across_variance))
        while self._others and self._others[0][0] <= self._sightings.newest:
            self._compare(*self._others.popleft())
        return measurement if alignment is None else alignment.corrected(measurement)

    def _compare(self, time: float, measurement: CameraMeasurement) -> None:
        """Compare what a further camera saw with what the first one sees at that time (s)."""
        sighting, found = _at(self._sightings, time), measurement.detections[0]
        if sighting is not None:
            seen = turned_back(measurement.view, turned_back(self._motion.attitude(time), sighting.direction))
            itself = turned_back(measurement.view, direction(found.azimuth, found.elevation))
            self.cameras[measurement.camera].compare(time, itself, seen, sighting.variance + found.across_variance)

    def correct(self, measurement: DoaMeasurement, time: float, newest: float) -> DoaMeasurement:
        """Compare a direction of arrival with the sighting of its time; returns it corrected.

        Parameters:
            measurement: the direction.
            time (s): its capture time.
            newest (s): capture time of the newest direction before.
        """
        sighting, cone = _at(self._sightings, time), measurement.cone
        if cone is not None and sighting is not None and measurement.confidence >= LEAST_CONFIDENCE:
            seen = turned_back(self._motion.attitude(time), sighting.direction)
            variance = cone.variance + self._floor**2 * cone.slope_squared
            self.array.compare(time, cone.cosine, *from_axis(cone.axis, seen), max(variance, LEAST_COMPARED_VARIANCE)
                               / effective_sample_fraction(time, newest, measurement.window), sighting.variance)
        return self.array.corrected(measurement)

    def diagnostics(self) -> dict[str, str]:
        """What is known of array and cameras, as texts."""
        learned: dict[str, SelfCalibration] = {'array': self.array, **self.cameras}
        texts = {f'{what} self-calibration: {name}': value for what, one in learned.items() if one.compared
                 for name, value in one.describe().items()}
        stands = [f'{name if what == "array" else f"{what} {name}"} {texts[f"{what} self-calibration: {name}"]}'
                  for what, one in learned.items() for name in one.at_limit]
        return texts | {AT_LIMIT: ', '.join(stands) or 'none'}


def _at(sightings: Timeline[Sighting], time: float) -> Sighting | None:
    """The direction of the target at a time (s), interpolated; None outside of the sightings and in gaps."""
    if not sightings.oldest < time <= sightings.newest:
        return None
    # A sighting of that very time counts by its predecessor, too: single ones may be wrong.
    earlier, later, share = sightings.around(math.nextafter(time, 0.0))
    if later.time - earlier.time > GAP_S:
        return None
    mean = combined(1.0 - share, earlier.direction, share, later.direction)
    length = max(math.sqrt(dot(mean, mean)), 1e-9)
    return Sighting(time, combined(1.0 / length, mean, 0.0, mean), later.variance)


def from_axis(axis: Vector, seen: Vector) -> tuple[float, float]:
    """Azimuth and elevation (rad) of a direction in a frame whose x axis is `axis` and whose y axis is level in the body."""
    level = max(math.hypot(axis[0], axis[1]), 1e-9)
    left = (-axis[1] / level, axis[0] / level, 0.0)
    return angles((dot(axis, seen), dot(left, seen), dot(cross(axis, left), seen)))
