"""An image as the filter uses it: what it shows, and what it would show of a component."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from av_fusion.measurement.measurements import CameraMeasurement, Detection
from av_fusion.measurement.vectors import Rows, Vector, angles, dot, tangents, turned
from av_fusion.tracks.component import GaussianComponent
from av_fusion.tracks.likelihood import Comparison, Match, WorldDirection, fits_of
from av_fusion.tracks.past_state import PastState, Row, share_within

OCCLUSION_S = 5.0  # time constant of changes of fog, and of what passes between camera and target
OCCLUDED = 0.02  # share of the time for which something near hides a target in clear air: the error of resolving by absence


class Image(NamedTuple):
    """An image in the world.

    Parameters:
        time (s): its capture time.
        measurement: detections in the body frame.
        directions: those of the detections in the world.
        view: axes of the camera in the world.
        visibility: 0..1, known or assumed.
        is_known: whether it was stated with the image.
        fraction: effective sample fraction.
    """

    time: float
    measurement: CameraMeasurement
    directions: Sequence[WorldDirection]
    view: Sequence[Vector]
    visibility: float
    is_known: bool
    fraction: float

    @classmethod
    def of(cls, time: float, measurement: CameraMeasurement, attitude: Rows, visibility: float, fraction: float) -> Image:
        """The image turned into the world by the rig's attitude of its time; `visibility` where it has none."""
        is_known = math.isfinite(measurement.visibility)
        return cls(time, measurement, [WorldDirection.of(detection, attitude) for detection in measurement.detections],
                   [turned(attitude, axis) for axis in zip(*measurement.view, strict=True)],
                   measurement.visibility if is_known else visibility, is_known, fraction)


def compare(component: GaussianComponent, past: PastState, image: Image, detected: float) -> Comparison:
    """A component compared with an image.

    Parameters:
        component, past: the component, and its direction at the capture time.
        image: the image.
        detected: probability that a target in view is detected where nothing hides it.
    """
    in_view = math.prod([extent.share(past) for extent in extents(past, image.view, image.measurement)])
    chance = detected * image.measurement.searched * in_view
    matches = [Match(direction.deviations(past), direction) for direction in image.directions]
    gain = detected * 2.0 * image.measurement.half_view
    found = np.array([gain * odds_of(detection) * fits_of(one) / math.sqrt(math.tau * one.deviations[0].noise)
                      for detection, one in zip(image.measurement.detections, matches, strict=True)])
    hidden = component.p_hidden(image.measurement.camera, image.time, 1.0 - (1.0 - OCCLUDED) * image.visibility, OCCLUSION_S,
                                image.is_known)
    return Comparison(component, past, matches, hidden, chance, found.reshape(-1, len(component.modes)).T)


class Extent(NamedTuple):
    """An angle of a component in the camera's frame, and the interval of it that the image shows.

    Parameters:
        angle (rad): azimuth or elevation.
        row: its derivatives with respect to the direction across and up.
        half_width (rad): the image shows angles from minus to plus this.
    """

    angle: float
    row: Row
    half_width: float

    def share(self, past: PastState) -> float:
        """Probability that the angle is within the interval."""
        return share_within(self.half_width, self.angle, past.variance(self.row))


def extents(past: PastState, view: Sequence[Vector], measurement: CameraMeasurement) -> list[Extent]:
    """Azimuth and elevation of a component in the camera's frame, see `Extent`.

    Parameters:
        past: the component at the image's capture time.
        view: axes of the camera in the world.
        measurement: the image.
    """
    x, y, z = (dot(axis, past.direction) for axis in view)
    azimuth, elevation = angles((x, y, z))
    rows = [(sum(a * dot(axis, past.left) for a, axis in zip(part, view, strict=True)),
             sum(a * dot(axis, past.above) for a, axis in zip(part, view, strict=True)))
            for part in tangents(azimuth, elevation)]
    level = max(math.cos(elevation), 1e-3)
    return [Extent(azimuth, (rows[0][0] / level, rows[0][1] / level), measurement.half_view),
            Extent(elevation, rows[1], measurement.half_height)]


def odds_of(detection: Detection) -> float:
    """Odds that a detection is the target."""
    return detection.score / max(1.0 - detection.score, 0.01)
