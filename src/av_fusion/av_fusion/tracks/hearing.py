"""A direction of arrival as the filter uses it, in the world."""

from __future__ import annotations

import math
from math import tau
from typing import NamedTuple

from av_fusion.measurement.measurements import DoaMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import Vector, turned
from av_fusion.tracks.likelihood import WorldCone, WorldDirection, WorldDirections
from av_fusion.tracks.settings import FilterSettings

UNIFORM_DENSITY = 1.0 / tau
LEAST_CLUTTER = 1e-3  # probability of clutter in a direction of arrival, however confident it is


class Hearing(NamedTuple):
    """A direction of arrival in the world.

    Parameters:
        source: compares it with components, and gives those that it may start.
        confidence: probability that it stems from a source.
        peak: density of the measurement over a uniform one, at its mode.
        end_fire: axis in the world at whose vertical plane components are to be split first; None for none.
    """

    source: WorldCone | WorldDirections
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


def hear(time: float, measurement: DoaMeasurement, settings: FilterSettings, motion: RigMotion) -> Hearing:
    """A direction of arrival turned into the world.

    Parameters:
        time (s): its capture time.
        measurement: the direction in the body frame.
        settings: see `FilterSettings`.
        motion: attitude of the rig.
    """
    floor = settings.sound_floor_sigma**2
    variance = min([h.across_variance for h in measurement.hypotheses]) + floor
    peak = measurement.confidence / len(measurement.hypotheses) / math.sqrt(tau * variance) / UNIFORM_DENSITY
    attitude, cone = motion.attitude(time), measurement.cone
    if cone is None:
        return Hearing(WorldDirections([WorldDirection.of(hypothesis, attitude, floor)
                                        for hypothesis in measurement.hypotheses]), measurement.confidence, peak)
    heard = WorldCone(turned(attitude, cone.axis), cone.cosine, cone.variance + floor * cone.slope_squared)
    off_axis = min(cone.angle, math.pi - cone.angle) ** 2 > 4.0 * variance
    return Hearing(heard, measurement.confidence, peak, heard.axis if off_axis else None)
