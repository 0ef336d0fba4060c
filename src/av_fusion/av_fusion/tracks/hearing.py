"""A direction of arrival as the filter uses it: its likelihood in the world, and the components that it may start."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from math import tau
from typing import NamedTuple

from av_fusion.measurement.measurements import DoaMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import Vector, angles, dot, tangents, turned
from av_fusion.tracks.likelihood import DirectionLikelihood, WorldCone, WorldDirection
from av_fusion.tracks.mixture import BirthComponent
from av_fusion.tracks.settings import FilterSettings

UNIFORM_DENSITY = 1.0 / tau
LEAST_CLUTTER = 1e-3  # probability of clutter in a direction of arrival, however confident it is


class Hearing(NamedTuple):
    """A direction of arrival in the world.

    Parameters:
        likelihood: compares it with components.
        births: gives the components that it may start.
        confidence: probability that it stems from a source.
        peak: density of the measurement over a uniform one, at its mode.
        end_fire: axis in the world at whose vertical plane components are to be split first; None for none.
    """

    likelihood: WorldCone | DirectionLikelihood
    births: Callable[[], list[BirthComponent]]
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
        directions = [WorldDirection.of(hypothesis, attitude, floor) for hypothesis in measurement.hypotheses]
        tempered = [direction._replace(across_variance=direction.across_variance / fraction,
                                       up_variance=direction.up_variance / fraction) for direction in directions]
        return Hearing(DirectionLikelihood(tempered), partial(births_of, directions, settings), measurement.confidence, peak)
    heard = WorldCone(turned(attitude, cone.axis), cone.cosine, cone.variance + floor * cone.slope_squared)
    off_axis = min(cone.angle, math.pi - cone.angle) ** 2 > 4.0 * variance
    return Hearing(heard._replace(variance=heard.variance / fraction), partial(heard.births, settings.model.elevations),
                   measurement.confidence, peak, heard.axis if off_axis else None)


def births_of(directions: Sequence[WorldDirection], settings: FilterSettings) -> list[BirthComponent]:
    """Components at alternative directions; of mirror images the one at the commoner elevation is the more likely."""
    births = [_birth_of(direction, settings) for direction in directions]
    weights = [settings.model.prior_of(birth.elevation, birth.vv) for birth in births]
    return [birth._replace(share=weight / sum(weights)) for birth, weight in zip(births, weights, strict=True)]


def _birth_of(direction: WorldDirection, settings: FilterSettings) -> BirthComponent:
    """A component at a measured direction.

    Parameters:
        direction: the direction in the world.
        settings: of targets; the commonest elevation is that of a direction without one.
    """
    azimuth, elevation = angles(direction.vector)
    across, variance = direction.across_variance, direction.up_variance
    if not direction.is_known:
        elevation, variance, _ = settings.model.elevations[0]
    left, above = tangents(azimuth, elevation)
    c, s = dot(direction.left, left), dot(direction.left, above)
    return BirthComponent(azimuth, elevation, c * c * across + s * s * variance, c * s * (across - variance),
                          s * s * across + c * c * variance, elevation_measured=direction.is_known)
