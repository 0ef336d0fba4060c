"""An image as the filter uses it: what it shows, and what it would show of a component."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_fusion.measurement.measurements import CameraMeasurement, Detection
from av_fusion.measurement.vectors import Rows, Vector, angles, dot, tangents, turned
from av_fusion.tracks.component import GaussianComponent
from av_fusion.tracks.likelihood import Deviation, WorldDirection, distances, share_within
from av_fusion.tracks.past_state import PastState


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


class SightComparison(NamedTuple):
    """An image compared with what a component predicts.

    Parameters:
        component, past: the component, and its direction at the capture time.
        deviations: of each detection.
        chance: probability that the target is in view and detected if nothing hides it.
        missed: probability that the image does not show the target.
        found (k, m): likelihood ratio of each detection in each mode of motion, from the target over a false one.
    """

    component: GaussianComponent
    past: PastState
    deviations: Sequence[Sequence[Deviation]]
    chance: float
    missed: float
    found: NDArray[np.float64]


def compare(component: GaussianComponent, past: PastState, image: Image, detected: float) -> SightComparison:
    """A component compared with an image.

    Parameters:
        component, past: the component, and its direction at the capture time.
        image: the image.
        detected: probability that a target in view is detected where nothing hides it.
    """
    chance = detected * share_in_view(past, image.view, image.measurement)
    deviations = [direction.deviations(past) for direction in image.directions]
    width = 2.0 * image.measurement.half_view
    found = [detected * odds_of(detection) * width * _densities(parts)
             for detection, parts in zip(image.measurement.detections, deviations, strict=True)]
    return SightComparison(component, past, deviations, chance, component.missed_detection(chance),
                           np.array(found).reshape(len(found), len(component.modes)).T)


def _densities(deviations: Sequence[Deviation]) -> NDArray[np.float64]:
    """Density (k,) of a detection under a component in each mode, across; reduced by its deviation up."""
    return np.asarray(np.exp(-0.5 * distances(deviations)) / np.sqrt(math.tau * deviations[0].totals))


def share_in_view(past: PastState, view: Sequence[Vector], measurement: CameraMeasurement) -> float:
    """Probability that a component is in the field of view.

    Parameters:
        past: the component at the image's capture time.
        view: axes of the camera in the world.
        measurement: the image.
    """
    x, y, z = (dot(axis, past.direction) for axis in view)
    azimuth, elevation = angles((x, y, z))
    across, up = tangents(azimuth, elevation)
    rows = [(sum(a * dot(axis, past.left) for a, axis in zip(part, view, strict=True)),
             sum(a * dot(axis, past.above) for a, axis in zip(part, view, strict=True))) for part in (across, up)]
    level = max(math.cos(elevation) ** 2, 1e-6)
    return (share_within(measurement.half_view, azimuth, past.variance(rows[0]) / level)
            * share_within(measurement.half_height, elevation, past.variance(rows[1])))


def odds_of(detection: Detection) -> float:
    """Odds that a detection is the target."""
    return detection.score / max(1.0 - detection.score, 0.01)

