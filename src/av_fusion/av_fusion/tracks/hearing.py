"""A direction of arrival as the filter uses it: its likelihood in the world, and the components that it may start."""

from __future__ import annotations

import math
from math import tau
from typing import NamedTuple

from av_fusion.measurement.measurements import Cone, DoaMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import Rows, Vector, angles, dot, tangents, turned
from av_fusion.tracks.likelihood import DirectionLikelihood, DoaLikelihood, WorldCone, WorldDirection
from av_fusion.tracks.mixture import BirthComponent
from av_fusion.tracks.settings import FilterSettings

UNIFORM_DENSITY = 1.0 / tau
LEAST_CLUTTER = 1e-3  # probability of clutter in a direction of arrival, however confident it is


class Hearing(NamedTuple):
    """A direction of arrival in the world.

    Parameters:
        likelihood: compares it with components.
        births: components that it may start.
        confidence: probability that it stems from a source.
        peak: density of the measurement over a uniform one, at its mode.
        end_fire: axis in the world at whose vertical plane components are to be split first; None for none.
    """

    likelihood: DoaLikelihood
    births: list[BirthComponent]
    confidence: float
    peak: float
    end_fire: Vector | None = None

    @property
    def clutter(self) -> float:
        """Probability that it stems from no source."""
        return max(1.0 - self.confidence, LEAST_CLUTTER)

    @property
    def odds(self) -> float:
        """Odds that it stems from a source."""
        return self.confidence / self.clutter


def hear(time: float, measurement: DoaMeasurement, fraction: float, settings: FilterSettings, motion: RigMotion) -> Hearing:
    """A direction of arrival turned into the world.

    Parameters:
        time (s): its capture time.
        measurement: the direction in the body frame.
        fraction: effective sample fraction of its window; its noise is divided by it.
        settings: see `FilterSettings`.
        motion: attitude of the rig.
    """
    floor = settings.sound_floor_sigma**2
    variance = min([h.across_variance for h in measurement.hypotheses]) + floor
    peak = measurement.confidence / len(measurement.hypotheses) / math.sqrt(tau * variance) / UNIFORM_DENSITY
    attitude, cone = motion.attitude(time), measurement.cone
    if cone is None:
        likelihood, births = _hear_directions(measurement, attitude, floor, fraction, settings)
        return Hearing(likelihood, births, measurement.confidence, peak)
    axis = turned(attitude, cone.axis)
    off_axis = min(cone.angle, math.pi - cone.angle) ** 2 > 4.0 * variance
    return Hearing(*_hear_cone(cone, axis, fraction, settings), measurement.confidence, peak, axis if off_axis else None)


def _hear_cone(cone: Cone, axis: Vector, fraction: float, settings: FilterSettings
               ) -> tuple[DoaLikelihood, list[BirthComponent]]:
    """A cone about an axis in the world."""
    model, variance = settings.model, cone.variance + settings.sound_floor_sigma**2 * cone.slope_squared
    births = WorldCone(axis, cone.cosine, variance).births(model.usual_elevation, model.usual_elevation_variance)
    return WorldCone(axis, cone.cosine, variance / fraction), births


def _hear_directions(measurement: DoaMeasurement, attitude: Rows, floor: float, fraction: float, settings: FilterSettings
                     ) -> tuple[DoaLikelihood, list[BirthComponent]]:
    """Alternative directions; of mirror images the one closer to the usual elevation is the more likely."""
    heard = [WorldDirection.of(hypothesis, attitude, floor) for hypothesis in measurement.hypotheses]
    births = [birth_of(direction, settings) for direction in heard]
    usual, spread = settings.model.usual_elevation, settings.model.usual_elevation_variance
    weights = [math.exp(max(-0.5 * (b.elevation - usual) ** 2 / (spread + b.vv), -300.0)) for b in births]
    births = [birth._replace(share=weight / sum(weights)) for birth, weight in zip(births, weights, strict=True)]
    return DirectionLikelihood([d._replace(across_variance=d.across_variance / fraction,
                                           up_variance=d.up_variance / fraction) for d in heard]), births


def birth_of(direction: WorldDirection, settings: FilterSettings) -> BirthComponent:
    """A component at a measured direction.

    Parameters:
        direction: the direction in the world.
        settings: of targets; their usual elevation is that of a direction without one.
    """
    azimuth, elevation = angles(direction.vector)
    across, variance = direction.across_variance, direction.up_variance
    if not direction.is_known:
        elevation, variance = settings.model.usual_elevation, settings.model.usual_elevation_variance
    left, above = tangents(azimuth, elevation)
    c, s = dot(direction.left, left), dot(direction.left, above)
    return BirthComponent(azimuth, elevation, c * c * across + s * s * variance, c * s * (across - variance),
                          s * s * across + c * c * variance, elevation_measured=direction.is_known)
