"""Measurements in the world compared with a component: densities, deviations, and the cosine that a linear array measures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_fusion.measurement.measurements import LEAST_LEVEL, Cone, Detection, DoaMeasurement, Hypothesis
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import Rows, Vector, angles, combined, cross, dot, tangents, turned
from av_fusion.measurement.vectors import direction as direction_of
from av_fusion.tracks.component import GaussianComponent
from av_fusion.tracks.curve import Curve
from av_fusion.tracks.motion import Elevation
from av_fusion.tracks.past_state import Deviation, PastState, Row
from av_fusion.tracks.settings import FilterSettings

UNIFORM_DENSITY = 1.0 / math.tau
LEAST_CLUTTER = 1e-3  # probability of clutter in a direction of arrival, however confident it is


class WorldDirection(NamedTuple):
    """A measured direction.

    Parameters:
        vector: unit vector; with an unknown elevation, in the sensor's level plane.
        left: unit vector to larger azimuths of the sensor.
        across_variance, up_variance (rad^2): of the errors along `left` and perpendicular to it; infinite where the
            elevation is unknown.
    """

    vector: Vector
    left: Vector
    across_variance: float
    up_variance: float

    @classmethod
    def of(cls, measured: Detection | Hypothesis, attitude: Rows, extra: float = 0.0) -> WorldDirection:
        """A direction in the body frame turned into the world; `extra` (rad^2) is added to its variance across."""
        known = math.isfinite(measured.elevation_variance)
        elevation = measured.elevation if known else 0.0
        return cls(turned(attitude, direction_of(measured.azimuth, elevation)),
                   turned(attitude, tangents(measured.azimuth, elevation)[0]), measured.across_variance + extra,
                   measured.elevation_variance)

    @property
    def is_known(self) -> bool:
        """Whether it has an elevation."""
        return math.isfinite(self.up_variance)

    def deviations(self, past: PastState) -> tuple[Deviation, ...]:
        """Deviations from a component: across, and up where the elevation is known."""
        h, v = dot(self.left, past.left), dot(self.left, past.above)
        if not self.is_known:
            return (self._beside(past),)
        norm = max(math.hypot(h, v), 1e-9)
        across, up = (h / norm, v / norm), (-v / norm, h / norm)
        x, y = past.offset(self.vector)
        return (Deviation.of(past, across, across[0] * x + across[1] * y, self.across_variance),
                Deviation.of(past, up, up[0] * x + up[1] * y, self.up_variance))

    def birth(self, settings: FilterSettings) -> GaussianComponent:
        """A component there, weighed by how common its elevation is.

        Parameters:
            settings: of targets; the commonest elevation is that of a direction without one.
        """
        azimuth, elevation = angles(self.vector)
        across, variance, usual = self.across_variance, self.up_variance, None
        if not self.is_known:
            usual = settings.model.elevations[0]
            elevation, variance, _ = usual
        left, above = tangents(azimuth, elevation)
        c, s = dot(self.left, left), dot(self.left, above)
        up = s * s * across + c * c * variance
        return GaussianComponent.born(settings.model.prior_of(elevation, up), azimuth, elevation,
                                      (c * c * across + s * s * variance, c * s * (across - variance), up), settings, usual)

    def _beside(self, past: PastState) -> Deviation:
        """The deviation from the half of a great circle through the sensor's vertical, on which all elevations lie."""
        distance, row = past.above_plane(self.left)
        if dot(self.vector, past.direction) < 0.0:  # on the other half
            distance = math.copysign(math.pi, distance) - distance
        level = 1.0 - dot(cross(self.vector, self.left), past.direction) ** 2
        return Deviation.of(past, row, -distance, self.across_variance * max(level, 0.01))


class Match(NamedTuple):
    """A measurement compared with what a component predicts.

    Parameters:
        deviations: the scalar measurements that it consists of.
        direction: the alternative that was compared; None for a cone.
        curve: the whole likelihood of a cosine, where it is known: as likely as the measurement by its peak alone.
    """

    deviations: Sequence[Deviation]
    direction: WorldDirection | None = None
    curve: Curve | None = None

    def likelier(self, past: PastState, modes: NDArray[np.float64], fraction: float) -> Deviation:
        """The first deviation, by the peak or by the whole likelihood: whichever is the likelier.

        Parameters:
            past: what the component predicts.
            modes (k,): probabilities of the modes of motion.
            fraction: effective sample fraction.
        """
        first = self.deviations[0]
        if self.curve is None or modes @ fits_of(Match(self.deviations)) >= modes @ self.curve.fits(1.0):
            return first
        return self.curve.deviation(past, first.row, fraction)


class Comparison(NamedTuple):
    """A component compared with a scan: the directions of a window of sound, or the detections of an image.

    Parameters:
        component, past: the component, and its direction at the capture time.
        matches: each measurement compared with it.
        hidden: probability that the target can be neither heard nor seen there.
        chance: probability that the scan shows it otherwise.
        found (k, m): likelihood of each measurement in each mode of motion, from the target over that of clutter.
    """

    component: GaussianComponent
    past: PastState
    matches: Sequence[Match]
    hidden: float
    chance: float
    found: NDArray[np.float64]

    @property
    def missed(self) -> float:
        """Probability that the scan does not show the target."""
        return self.hidden + (1.0 - self.hidden) * (1.0 - self.chance)


class WorldCone(NamedTuple):
    """The cosine of the angle from an axis, whichever of the images is the source.

    Parameters:
        axis: unit vector of the array's axis in the world.
        cosine: measured cosine of the angle from the axis.
        variance: variance of the cosine's error from all causes.
        likelihood (n,): at even cosines from -1 to 1, over that of the measured one by the peak alone; None where unknown.
    """

    axis: Vector
    cosine: float
    variance: float
    likelihood: NDArray[np.float64] | None = None

    def compare(self, past: PastState) -> Match:
        """Compare with a component, whose direction at the capture time is `past`."""
        means, variances, row = expected_cosine(past, self.axis)
        curve = None if self.likelihood is None else Curve.of(means, variances, self.likelihood)
        return Match((Deviation(row, self.cosine - means, variances + self.variance, self.variance),), None, curve)

    def births(self, settings: FilterSettings) -> list[GaussianComponent]:
        """Components at both images, where the cone meets the likely elevations of the sky, clockwise of the axis first.

        None for an axis that is close to the vertical, whose cone meets all azimuths. Their weights are those of the
        elevations, times the density of the cosine there, where all azimuths are equally likely.

        Parameters:
            settings: of targets.
        """
        if math.hypot(self.axis[0], self.axis[1]) < LEAST_LEVEL:    # a vertical axis says nothing of the azimuth
            return []
        return normalised([image for usual in settings.model.elevations for image in self._images(usual, settings)])

    def _images(self, usual: Elevation, settings: FilterSettings) -> list[GaussianComponent]:
        """Both images of about one elevation; their weights are not normalised."""
        x, y, z = self.axis
        level, variance = math.hypot(x, y), usual.variance
        climb, angle = math.asin(min(max(z, -1.0), 1.0)), math.acos(min(max(self.cosine, -1.0), 1.0))
        highest = min(climb + angle, math.pi - climb - angle)
        elevation = min(max(usual.mean, climb - angle, -0.5 * math.pi), climb + angle, 0.5 * math.pi)
        width, sine = level * max(math.cos(elevation), 0.05), math.sin(elevation)
        ratio = min(max((self.cosine - z * sine) / width, -1.0), 1.0)
        to_elevation = (self.cosine * sine - z) / (width * math.cos(elevation)) if math.cos(elevation) > 0.05 else 0.0
        noise = self.variance / width**2
        steepness = math.sqrt(max(1.0 - ratio * ratio, math.sqrt(noise + to_elevation**2 * variance)))
        apart, azimuth, cosine = math.acos(ratio), math.atan2(y, x), math.cos(elevation)
        share = usual.share * 0.5 * math.erfc((usual.mean - highest) / math.sqrt(2.0 * variance)) / (width * steepness)
        images = []
        for side in (-1.0, 1.0):
            slope = -side * to_elevation / steepness  # of the azimuth by elevation
            across = (noise / steepness**2 + slope * slope * variance) * cosine**2
            images.append(GaussianComponent.born(share, math.remainder(azimuth + side * apart, math.tau), elevation,
                                                 (across, slope * variance * cosine, variance), settings, usual))
        return images


def expected_cosine(past: PastState, axis: Vector) -> tuple[NDArray[np.float64], NDArray[np.float64], Row]:
    """Means and variances (k,) of the cosine of the angle between a target and an axis, and mean derivatives across and up.

    With azimuth d and elevation e of the target from its mean, the cosine is x cos d cos e + y sin d cos e + z sin e, where
    x, y, z are the axis along the mean and the axes of its plane. For Gaussian d and e all moments follow in closed form from
    E cos x = exp(-v/2); by Stein's lemma the covariance with the state is its covariance matrix times the mean gradient
    (Sarkka, Bayesian Filtering and Smoothing, 2013, eq. 6.3). Exact moments need no bounds where the cosine is flat, at
    end-fire. The modes differ little in their means, to first order.

    Parameters:
        past: the target's direction.
        axis: unit vector of the axis in the world.
    """
    x, y, z = dot(axis, past.direction), dot(axis, past.left), dot(axis, past.above)
    h, v, c = past.spreads[:, 0, 0], past.spreads[:, 1, 1], past.spreads[:, 0, 1]
    fade_sum, fade_difference = np.exp(-0.5 * (h + v) - c), np.exp(-0.5 * (h + v) + c)
    both = 0.5 * (fade_sum + fade_difference)  # E cos d cos e
    twice_h, twice_v = np.exp(-2.0 * h), np.exp(-2.0 * v)
    twice_both = 0.5 * (np.exp(-2.0 * (h + v) - 4.0 * c) + np.exp(-2.0 * (h + v) + 4.0 * c))
    mixed = 0.5 * (np.exp(-0.5 * h - 2.0 * v + 2.0 * c) - np.exp(-0.5 * h - 2.0 * v - 2.0 * c))  # E sin d sin 2e
    square = (0.25 * x * x * (1.0 + twice_h + twice_v + twice_both) + 0.25 * y * y * (1.0 - twice_h + twice_v - twice_both)
              + 0.5 * z * z * (1.0 - twice_v) + y * z * mixed)
    across, up = y * both, z * np.exp(-0.5 * v) - 0.5 * y * (fade_difference - fade_sum)
    means = x * both
    row = float(past.modes @ across), float(past.modes @ up)
    return means + past.deviations(row), np.maximum(square - means**2, 1e-12), row


class WorldDirections(NamedTuple):
    """Alternative directions; each component is compared with the one that is likeliest in any mode.

    Parameters:
        directions: the directions in the world.
    """

    directions: Sequence[WorldDirection]

    def compare(self, past: PastState) -> Match:
        """See `WorldCone`."""
        alternatives = [Match(direction.deviations(past), direction) for direction in self.directions]
        return max(alternatives, key=lambda match: float(fits_of(match).max()))

    def births(self, settings: FilterSettings) -> list[GaussianComponent]:
        """Components at the directions; of mirror images the one at the commoner elevation is the more likely.

        Parameters:
            settings: of targets.
        """
        return normalised([direction.birth(settings) for direction in self.directions])


def normalised(births: list[GaussianComponent]) -> list[GaussianComponent]:
    """The components with weights that sum to one."""
    total = sum([birth.weight for birth in births])
    for birth in births:
        birth.weight /= total
    return births


def fits_of(match: Match, factor: float = 1.0) -> NDArray[np.float64]:
    """Likelihood (k,) of a direction in each mode, by the first deviation, and reduced by the others.

    It is relative to that of a component that predicts the measured value without error and variance: at most 1.

    Parameters:
        match: the direction, compared with a component.
        factor: by which the variance of its noise is multiplied.
    """
    deviations = match.deviations
    squares = sum([one.innovations**2 / (one.totals + (factor - 1.0) * one.noise) for one in deviations])
    first, noise = deviations[0], factor * deviations[0].noise
    fits = np.exp(-0.5 * squares) * np.sqrt(noise / (first.totals - first.noise + noise))
    return np.asarray(fits if match.curve is None else 0.5 * (fits + match.curve.fits(1.0 / factor)))


class Hearing(NamedTuple):
    """A direction of arrival in the world.

    Parameters:
        source: compares it with components, and gives those that it may start.
        confidence: probability that it stems from a source.
        peak: density of the measurement over a uniform one, at its mode.
        clutter: probability that it stems from no source.
        mirror: normal in the world of the plane between its mirror images, at which components are to be split first; None for
            none.
    """

    source: WorldCone | WorldDirections
    confidence: float
    peak: float
    clutter: float
    mirror: Vector | None = None

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
    peak = measurement.confidence / len(measurement.hypotheses) / math.sqrt(math.tau * variance) / UNIFORM_DENSITY
    attitude, cone, clutter = motion.attitude(time), measurement.cone, max(1.0 - measurement.confidence, LEAST_CLUTTER)
    if cone is None:
        directions, mirror = [WorldDirection.of(one, attitude, floor) for one in measurement.hypotheses], None
        if mirror_axis(measurement.hypotheses, None) is not None:
            apart = combined(1.0, directions[0].vector, -1.0, directions[1].vector)
            mirror = combined(1.0 / math.sqrt(dot(apart, apart)), apart, 0.0, apart)
        return Hearing(WorldDirections(directions), measurement.confidence, peak, clutter, mirror)
    heard = WorldCone(turned(attitude, cone.axis), cone.cosine, cone.variance + floor * cone.slope_squared,
                      np.array(measurement.odds) * (clutter / peak) if measurement.odds else None)
    level, mirror = math.hypot(heard.axis[0], heard.axis[1]), None
    if level >= LEAST_LEVEL and min(cone.angle, math.pi - cone.angle) ** 2 > 4.0 * variance:
        mirror = (-heard.axis[1] / level, heard.axis[0] / level, 0.0)
    return Hearing(heard, measurement.confidence, peak, clutter, mirror)


def mirror_axis(hypotheses: Sequence[Hypothesis], cone: Cone | None) -> Vector | None:
    """Axis in the body frame about which the images of a measurement are mirrored.

    None for a single direction, and for images of one azimuth, such as those above and below a horizontal planar array.

    Parameters:
        hypotheses: directions in the body frame.
        cone: their cone; None for other arrays than linear ones.
    """
    if cone is not None:
        return cone.axis
    if len(hypotheses) != 2:
        return None
    first, second = hypotheses
    apart = math.remainder(second.azimuth - first.azimuth, math.tau)
    if apart**2 < 4.0 * max(first.across_variance, second.across_variance):
        return None
    middle = first.azimuth + 0.5 * apart
    return math.cos(middle), math.sin(middle), 0.0
