"""Calibration of directions of arrival by what the camera sees at the same time."""

from __future__ import annotations

import math
from typing import NamedTuple

from av_common.timeline import Timeline
from av_fusion.calibration.array_calibration import LEAST_CONFIDENCE, ArraySelfCalibration
from av_fusion.measurement.measurements import Detection, DoaMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import Rows, Vector, angles, combined, cross, direction, dot, turned, turned_back
from av_fusion.tracks.filter import effective_sample_fraction

AT_LIMIT = 'self-calibration at its limit'
LEAST_COMPARED_VARIANCE = 1e-5  # of a cosine that is compared with a sighting
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
    """Compares directions of arrival with sightings of their time, and corrects them by all comparisons so far.

    Attributes:
        array: what is known of the array.

    Parameters:
        enabled: whether they are compared at all.
        floor (rad): error of directions of arrival beyond what they report.
        motion: attitude of the rig.
    """

    def __init__(self, enabled: bool, floor: float, motion: RigMotion) -> None:
        self._enabled, self._floor, self._motion = enabled, floor, motion
        self.array = ArraySelfCalibration()
        self.reset()

    def reset(self) -> None:
        """Discard the sightings, but keep what is known of the array."""
        self._sightings: Timeline[Sighting] = Timeline(KEPT_S)

    def turn_world(self, rows: Rows) -> None:
        """Turn the sightings with the world, where the rig's attitude was corrected."""
        self._sightings.change(lambda one: one._replace(direction=turned(rows, one.direction)))

    def see(self, time: float, best: Detection | None) -> None:
        """Note the best detection of an image captured at `time` (s), if it is certain enough."""
        if not self._enabled or time <= self._sightings.newest:
            return
        if best is not None and best.score >= LEAST_CONFIDENCE:
            seen = turned(self._motion.attitude(time), direction(best.azimuth, best.elevation))
            self._sightings.add(time, Sighting(time, seen, best.across_variance))

    def _seen(self, time: float) -> Sighting | None:
        """The direction of the target at `time` (s), interpolated; None outside of the sightings and in gaps."""
        if not self._sightings.oldest < time <= self._sightings.newest:
            return None
        # A sighting of that very time counts by its predecessor, too: single ones may be wrong.
        earlier, later, share = self._sightings.around(math.nextafter(time, 0.0))
        if later.time - earlier.time > GAP_S:
            return None
        mean = combined(1.0 - share, earlier.direction, share, later.direction)
        length = max(math.sqrt(dot(mean, mean)), 1e-9)
        return Sighting(time, combined(1.0 / length, mean, 0.0, mean), later.variance)

    def correct(self, measurement: DoaMeasurement, time: float, newest: float) -> DoaMeasurement:
        """Compare a direction of arrival with the sighting of its time; returns it corrected.

        Parameters:
            measurement: the direction.
            time (s): its capture time.
            newest (s): capture time of the newest direction before.
        """
        sighting, cone = self._seen(time), measurement.cone
        if cone is not None and sighting is not None and measurement.confidence >= LEAST_CONFIDENCE:
            seen = turned_back(self._motion.attitude(time), sighting.direction)
            variance = cone.variance + self._floor**2 * cone.slope_squared
            self.array.compare(time, cone.cosine, *from_axis(cone.axis, seen), max(variance, LEAST_COMPARED_VARIANCE)
                               / effective_sample_fraction(time, newest, measurement.window), sighting.variance)
        return self.array.corrected(measurement)

    def diagnostics(self) -> dict[str, str]:
        """What is known of the array, as texts."""
        learned = self.array.describe() if self.array.compared else {}
        return {f'array self-calibration: {name}': value for name, value in learned.items()} | {
            AT_LIMIT: ', '.join(f'{name} {learned[name]}' for name in self.array.at_limit) or 'none'}


def from_axis(axis: Vector, seen: Vector) -> tuple[float, float]:
    """Azimuth and elevation (rad) of a direction in a frame whose x axis is `axis` and whose y axis is level in the body."""
    level = max(math.hypot(axis[0], axis[1]), 1e-9)
    left = (-axis[1] / level, axis[0] / level, 0.0)
    return angles((dot(axis, seen), dot(left, seen), dot(cross(axis, left), seen)))
