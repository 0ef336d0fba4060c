"""Measurements that trackers use, as plain data.

Azimuths are in rad, counter-clockwise; "body" is the rig's frame (x forward, y left, z up), which tilts with the rig,
"world" is ENU. Times are capture
times in s. Named tuples, because thousands are made each second of a replay.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple, TypeVar

from av_common.frames import UNIT_TOLERANCE
from av_common.rig import CAMERAS
from av_fusion.measurement.vectors import IDENTITY, Rows, Vector, angles, dot

LEAST_LEVEL = 0.1  # horizontal part of an axis or a direction; closer to the vertical azimuths are not measured
LEAST_SINE = 0.05  # even close to its axis a linear array measures azimuth with a finite error
COSINE_TOLERANCE = 1e-3  # excess of a cosine over 1 by single precision and rotations
LEAST_VARIANCE, LARGEST_VARIANCE = 1e-10, 40.0  # rad^2; variances outside are errors of the sender, or carry no information


class Hypothesis(NamedTuple):
    """One possible direction of arrival in the body frame.

    Parameters:
        azimuth (rad): direction around the body's z axis.
        across_variance (rad^2): variance of the azimuth's error times cos(elevation).
        elevation (rad), elevation_variance (rad^2): infinite variance where the array does not measure it.
    """

    azimuth: float
    across_variance: float
    elevation: float = 0.0
    elevation_variance: float = math.inf


class Cone(NamedTuple):
    """Measurement of a linear array: the angle between the direction of arrival and the array's axis.

    Parameters:
        axis: unit vector of the array's axis in the body frame.
        cosine: measured cosine of the angle.
        variance: variance of the cosine's error.
    """

    axis: Vector
    cosine: float
    variance: float

    @property
    def angle(self) -> float:
        """Angle from the axis in rad, 0..pi."""
        return math.acos(min(max(self.cosine, -1.0), 1.0))

    @property
    def slope_squared(self) -> float:
        """Square of the derivative of the cosine by azimuth, for horizontal directions; bounded from below at the axis."""
        return max(1.0 - self.cosine * self.cosine, LEAST_SINE**2)

    def images(self) -> tuple[Hypothesis, Hypothesis]:
        """The two directions on the cone in the body's xy plane, or closest to it, clockwise of the axis first."""
        azimuth, elevation = angles(self.axis)
        level = max(math.cos(elevation), LEAST_LEVEL)
        apart = math.acos(min(max(self.cosine / level, -1.0), 1.0))
        variance = self.variance / max(level**2 - self.cosine**2, LEAST_SINE**2)
        return (Hypothesis(math.remainder(azimuth - apart, math.tau), variance),
                Hypothesis(math.remainder(azimuth + apart, math.tau), variance))


class DoaMeasurement(NamedTuple):
    """Direction of arrival from one window of sound.

    Parameters:
        time (s): centre of the window.
        hypotheses: mirror images, of which exactly one is the direction of the source.
        confidence: probability 0..1 that the direction stems from a source and not from noise.
        window (s): length of the analysis window; estimates of overlapping windows are not independent.
        cone: the cone of a linear array, whose two images are the hypotheses; None for other arrays. Close to the axis the
            hypotheses, which are estimates of the angle, differ from the images of the measured cosine.
        drone_probability: probability that the source is a drone, if drones were as frequent as all else; NaN if unknown.
        fundamental (Hz), fundamental_variance (Hz^2): of the source's harmonics; NaN if unknown.
        odds: see `av_interfaces/DoaOdds`; empty where unknown.
    """

    time: float
    hypotheses: tuple[Hypothesis, ...]
    confidence: float
    window: float = 0.5
    cone: Cone | None = None
    drone_probability: float = math.nan
    fundamental: float = math.nan
    fundamental_variance: float = math.nan
    odds: tuple[float, ...] = ()

    @classmethod
    def of_cone(cls, time: float, cone: Cone, confidence: float, window: float = 0.5) -> DoaMeasurement:
        """The measurement of a linear array.

        Parameters:
            time (s): centre of the window.
            cone: the measured cone.
            confidence: probability 0..1 that the source is the target.
            window (s): length of the window.
        """
        return cls(time, cone.images(), confidence, window, cone)


class Detection(NamedTuple):
    """One object detected in an image, in the body frame.

    Parameters:
        azimuth (rad): direction around the body's z axis.
        across_variance (rad^2): variance of the azimuth's error times cos(elevation).
        score: calibrated score 0..1 of the detector, the probability that the object is a target.
        elevation (rad), elevation_variance (rad^2): infinite variance if unknown.
    """

    azimuth: float
    across_variance: float
    score: float
    elevation: float = 0.0
    elevation_variance: float = math.inf


class CameraMeasurement(NamedTuple):
    """All detections in one image, possibly none.

    Parameters:
        time (s): capture time of the image.
        detections: see `Detection`.
        half_view, half_height (rad): half of the field of view, horizontally and vertically.
        visibility: 0..1, see `av_interfaces/Visibility`; NaN if unknown.
        view: rotation of the camera (x through the middle of its field of view, z up in the image) on the body.
        camera: its name.
        searched: share of the view that was searched.
    """

    time: float
    detections: tuple[Detection, ...]
    half_view: float = 0.6
    half_height: float = 0.5
    visibility: float = math.nan
    view: Rows = IDENTITY
    camera: str = CAMERAS[0]
    searched: float = 1.0

    @property
    def best(self) -> Detection | None:
        """The detection of highest score."""
        return max(self.detections, key=lambda detection: detection.score, default=None)

    def blurred(self, variance: float) -> CameraMeasurement:
        """The measurement by a camera whose orientation has an error of a variance (rad^2) about each axis."""
        return self._replace(detections=tuple([
            one._replace(across_variance=one.across_variance + variance, elevation_variance=one.elevation_variance + variance)
            for one in self.detections]))


def usable_doa(measurement: DoaMeasurement) -> DoaMeasurement | None:
    """The measurement with its plausible hypotheses; None if nothing plausible is left."""
    plausible = (math.isfinite(measurement.time) and 0.0 < measurement.confidence <= 1.0
                 and 0.0 < measurement.window <= 60.0)
    if not plausible:
        return None
    kept, cone = _usable(measurement.hypotheses), measurement.cone
    if not kept or (cone is not None and (len(kept) < len(measurement.hypotheses) or not _is_usable_cone(cone))):
        return None  # the images of a cone are usable together or not at all
    return measurement if kept == measurement.hypotheses else measurement._replace(hypotheses=kept)


def usable_doas(measurements: Iterable[DoaMeasurement]) -> list[DoaMeasurement]:
    """The measurements of which something plausible is left, see `usable_doa`."""
    return [usable for usable in map(usable_doa, measurements) if usable is not None]


def usable_camera(measurement: CameraMeasurement) -> CameraMeasurement | None:
    """The measurement with its plausible detections; None if time or view are not plausible."""
    if not (math.isfinite(measurement.time) and all(abs(dot(row, row) - 1.0) < UNIT_TOLERANCE for row in measurement.view)
            and 0.0 < measurement.half_view <= math.pi and 0.0 < measurement.half_height <= math.pi):
        return None
    kept = tuple(d for d in _usable(measurement.detections) if 0.0 <= d.score <= 1.0)
    visibility = measurement.visibility
    if visibility < 0.0 or visibility > 1.0:
        visibility = math.nan
    unchanged = kept == measurement.detections and visibility is measurement.visibility
    return measurement if unchanged else measurement._replace(detections=kept, visibility=visibility)


def _is_usable_cone(cone: Cone) -> bool:
    return (abs(dot(cone.axis, cone.axis) - 1.0) < UNIT_TOLERANCE and abs(cone.cosine) <= 1.0 + COSINE_TOLERANCE
            and LEAST_VARIANCE <= cone.variance <= LARGEST_VARIANCE)


_Direction = TypeVar('_Direction', Hypothesis, Detection)


def _usable(directions: tuple[_Direction, ...]) -> tuple[_Direction, ...]:
    """Directions with a plausible azimuth; an implausible elevation counts as unknown."""
    kept = []
    for one in directions:
        if abs(one.azimuth) <= 10.0 and LEAST_VARIANCE <= one.across_variance <= LARGEST_VARIANCE:
            variance = one.elevation_variance
            is_plausible = LEAST_VARIANCE <= variance <= LARGEST_VARIANCE or variance == math.inf
            kept.append(one if is_plausible and abs(one.elevation) <= 0.5 * math.pi else
                        one._replace(elevation=0.0, elevation_variance=math.inf))
    return tuple(kept)
