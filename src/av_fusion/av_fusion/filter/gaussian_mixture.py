"""The posterior at one time: Gaussian components, and a uniform background for a target elsewhere or no target."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from math import remainder, tau
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from av_fusion.filter.component_merging import are_mergeable, merge, split
from av_fusion.filter.gaussian_component import GaussianComponent
from av_fusion.filter.motion_model import MotionModel
from av_fusion.filter.normal_distribution import share_within
from av_fusion.filter.past_state import PastState
from av_fusion.measurement.vectors import ZERO, Rows, Vector, dot, offset, tangents

AGREEING, CLOSE = math.radians(10.0), math.radians(25.0)  # components closer together are one direction, on one side of an axis
PRIMARY_RATIO = 1.5  # weight of another component, relative to the primary one, from which it becomes primary
OUTLIER_S = 2.0  # correlation time of a source of outliers that is always present
LEAST_WEIGHT = 1e-6  # least weight of a component
LEAST_BACKGROUND = 1e-9
LARGEST_BIRTH_RATIO = 50.0  # weight of a birth over that of the background
_WEIGHT = attrgetter('weight')


class BirthComponent(NamedTuple):
    """A direction in the world that may start a component.

    Parameters:
        azimuth, elevation (rad): the direction.
        hh, hv, vv (rad^2): its covariance across and up.
        gates: whether a component, given by its direction at the capture time, explains the measurement.
        ratio: weight of the birth over that of the background; an existing component that gates the direction receives it.
        elevation_measured: whether the elevation was measured.
        least: smallest weight of the component afterwards, over that of the background.
        newest_doa, newest_sighting (s): capture time of the measurement, depending on its kind.
    """

    azimuth: float
    elevation: float
    hh: float
    hv: float
    vv: float
    gates: Callable[[PastState], bool]
    ratio: float
    elevation_measured: bool = False
    least: float = 0.0
    newest_doa: float = -math.inf
    newest_sighting: float = -math.inf


class GaussianMixture:
    """Gaussian components and a background, whose weights sum to one after `reduce`.

    The argument `lag` (s) is the time of the mixture minus the time of a measurement.

    Attributes:
        components: the Gaussians.
        background: probability that the target is elsewhere, or that there is none.
        p_outlier: probability that the direction of arrival is an outlier if the target is in the background.
        rate_variance: see below.

    Parameters:
        model: motion of targets.
        rate_variance (rad^2/s^2): initial variance of the rate of a birth across, and up far from the horizon.
        lost_variance (rad^2): components of larger variance are removed.
    """

    def __init__(self, model: MotionModel, rate_variance: float, lost_variance: float) -> None:
        self.components: list[GaussianComponent] = []
        self.background = 1.0
        self.p_outlier = 0.0
        self.model, self.rate_variance, self._lost_variance = model, rate_variance, lost_variance
        self._primary: GaussianComponent | None = None

    def predict(self, dt: float, noise_scale: float, kept: float, moved: Vector = ZERO) -> None:
        """Predict every component by `dt` s; the probability 1 - `kept` moves to the background.

        Parameters:
            dt (s): duration of the prediction.
            noise_scale: factor of the acceleration density.
            kept: probability that the target is still present.
            moved (m): displacement of the rig meanwhile, in the world.
        """
        for component in self.components:
            component.predict(dt, self.model, noise_scale, moved)
            component.weight *= kept
        self.background += (1.0 - kept) * (1.0 - self.background)

    def predict_outlier(self, dt: float, rate: float, width: float) -> None:
        """Predict the probabilities of an outlier by `dt` s: a two-state Markov chain with stationary probability `rate`.

        The rarer outliers are, the shorter they last. A new outlier may appear in any direction; `width` is the share of the
        circle in which it would be mistaken for a component.

        Parameters:
            dt (s): duration of the prediction.
            rate: long-run probability of an outlier.
            width: share of the circle, 0..1.
        """
        kept = math.exp(-dt / max(rate * OUTLIER_S, 1e-6))
        self.p_outlier = rate + kept * (self.p_outlier - rate)
        starts, ends = (1.0 - kept) * rate * width, (1.0 - kept) * (1.0 - rate)
        for component in self.components:
            component.p_outlier += (1.0 - component.p_outlier) * starts - component.p_outlier * ends

    def update_outlier(self, direct: Sequence[float], anywhere: float) -> None:
        """Weigh all hypotheses by a direction of arrival, which stems from the target or from an outlier.

        A persistent outlier is as predictable as a target: it is expected where the best of the other components predicts
        it. A hundred directions that contradict a component therefore weigh hardly more than one.

        Parameters:
            direct: likelihood under each component, if it stems from the target.
            anywhere: likelihood if it stems from any direction.
        """
        second, best = sorted((anywhere, anywhere, *direct))[-2:]
        for component, likelihood in zip(self.components, direct, strict=True):
            component.weight *= _marginal_likelihood(component, likelihood, second if likelihood == best else best)
        self.background *= _marginal_likelihood(self, 1.0, max(best, 1.0))

    def split(self, axis: Vector, lag: float, moved: Vector) -> None:
        """Split components that extend to both sides of the vertical plane of an axis.

        Parameters:
            axis: unit vector of the axis in the world.
            lag (s): time of the mixture minus time of the measurement.
            moved (m): displacement of the rig meanwhile, in the world.
        """
        self.components = [part for component in self.components for part in split(component, axis, lag, moved)]

    def weigh_by_cue(self, cue: Vector, variance: float, wrong: float) -> None:
        """Weigh the components among each other by where others say that a target is.

        The cue decides between hypotheses: it moves no component, makes none more precise, and says nothing about whether there
        is a target. With the probability `wrong` it concerns another target, which may be anywhere.

        Parameters:
            cue: unit vector in the world.
            variance (rad^2): of its direction along each axis.
            wrong: probability that it concerns another target.
        """
        total = sum([component.weight for component in self.components])
        for component in self.components:
            left, above = tangents(component.azimuth, component.elevation)
            apart = np.array(offset(component.direction, left, above, cue))
            S = component.covariance[:2, :2] + variance * np.eye(2)
            density = math.exp(-0.5 * float(apart @ np.linalg.solve(S, apart))) / (tau * math.sqrt(float(np.linalg.det(S))))
            component.weight *= wrong + (1.0 - wrong) * density * 2.0 * tau
        changed = sum([component.weight for component in self.components])
        for component in self.components:
            component.weight *= total / changed

    def turn_world(self, rows: Rows) -> None:
        """Turn all components with the world, where the rig's attitude was corrected."""
        for component in self.components:
            component.turn_world(rows)

    def add_births(self, lag: float, noise_scale: float, moved: Vector, births: Sequence[BirthComponent]) -> None:
        """Start components, or add the weight of births to components that gate them.

        The weight of the background remains; the caller updates it by the likelihood of the whole measurement.

        Parameters:
            lag (s): time of the mixture minus time of the measurement.
            noise_scale: factor of the acceleration density.
            moved (m): displacement of the rig meanwhile, in the world.
            births: directions that may start components.
        """
        known = [(component, component.at(lag, moved)) for component in self.components] if births else []
        for birth in births:
            weight, least = (self.background * min(ratio, LARGEST_BIRTH_RATIO) for ratio in (birth.ratio, birth.least))
            for component, past in known:
                if birth.gates(past):
                    component.weight = max(component.weight + weight, least)
                    break
            else:
                self.components.append(self._component_of(birth, max(weight, least), lag, noise_scale, moved))

    def _component_of(self, birth: BirthComponent, weight: float, lag: float, noise_scale: float,
                      moved: Vector) -> GaussianComponent:
        level, model = math.cos(birth.elevation) ** 2, self.model
        up_rate_variance = level * model.climb_variance + (1.0 - level) * self.rate_variance
        covariance = np.diag((birth.hh, birth.vv, self.rate_variance, up_rate_variance, model.usual_inverse_range**2))
        covariance[0, 1] = covariance[1, 0] = birth.hv
        component = GaussianComponent(weight, birth.azimuth, birth.elevation, covariance,
                                      inverse_range=model.usual_inverse_range,
                                      elevation_measured=birth.elevation_measured, newest_doa=birth.newest_doa,
                                      newest_sighting=birth.newest_sighting)
        if lag > 0.0:
            component.predict(lag, model, noise_scale, moved)
        return component

    def reduce(self) -> None:
        """Normalise, merge components that agree, and remove those of little weight or large variance."""
        components = sorted(self.components, key=_WEIGHT, reverse=True)
        total = self.background + sum([component.weight for component in components])
        kept: list[GaussianComponent] = []
        self.components = kept
        self.background /= total
        for component in components:
            component.weight /= total
            for other in kept:
                if are_mergeable(other, component):
                    merge(other, component)
                    break
            else:
                if component.weight >= LEAST_WEIGHT and component.across_variance <= self._lost_variance:
                    kept.append(component)
                else:
                    share = component.weight / (self.background + component.weight)
                    self.p_outlier += share * (component.p_outlier - self.p_outlier)
                    self.background += component.weight
        self.background = max(self.background, LEAST_BACKGROUND)

    def primary(self) -> GaussianComponent | None:
        """The heaviest component; the previous one is kept until another is clearly heavier."""
        heaviest = max(self.components, key=_WEIGHT, default=None)
        previous = self._primary
        if (heaviest is None or previous is None or previous not in self.components
                or heaviest.weight > PRIMARY_RATIO * previous.weight):
            self._primary = heaviest
        return self._primary

    def share_of(self, primary: GaussianComponent, axis: Vector | None) -> float:
        """Probability of the direction of the primary component, given that there is a target.

        Components that agree with it count, and those close to it on its side of the axis about which directions of arrival
        are mirrored.

        Parameters:
            primary: the primary component.
            axis: unit vector of the axis in the world, None without one.
        """
        azimuth = math.nan if axis is None else math.atan2(axis[1], axis[0])
        side, agreeing, total = math.sin(primary.azimuth - azimuth), 0.0, 0.0
        for component in self.components:
            total += component.weight
            apart = min(abs(remainder(primary.azimuth - component.azimuth, tau)),  # at the zenith azimuths mean little
                        math.acos(min(max(dot(primary.direction, component.direction), -1.0), 1.0)))
            if apart < AGREEING or (apart < CLOSE and side * math.sin(component.azimuth - azimuth) > 0.0):
                agreeing += component.weight
        return agreeing / total

    def predicted(self, component: GaussianComponent, ahead: float, noise_scale: float, moved: Vector) -> GaussianComponent:
        """A copy of a component, valid `ahead` s after the mixture.

        Parameters:
            component: one of the components.
            ahead (s): time after that of the mixture.
            noise_scale: factor of the acceleration density.
            moved (m): displacement of the rig meanwhile, in the world.
        """
        return component.predicted(ahead, self.model, noise_scale, moved)

    def front_probability(self, attitude: Rows, ahead: float, noise_scale: float, moved: Vector) -> float:
        """Probability, given that there is a target, that its azimuth in the body will be within 90 degrees in `ahead` s.

        Parameters:
            attitude: of the body in the world at that time.
            ahead (s): time after that of the mixture.
            noise_scale: factor of the acceleration density.
            moved (m): displacement of the rig meanwhile, in the world.
        """
        front = total = 0.0
        for component in self.components:
            total += component.weight
            front += component.weight * front_share(self.predicted(component, ahead, noise_scale, moved), attitude)
        return front / total


def front_share(component: GaussianComponent, attitude: Rows) -> float:
    """Probability that a component's azimuth in the body is within 90 degrees."""
    found = component.in_body(attitude)
    return share_within(0.5 * math.pi, found.azimuth, found.azimuth_variance)


def _marginal_likelihood(part: GaussianComponent | GaussianMixture, direct: float, outlier: float) -> float:
    """Likelihood of a direction of arrival from the target (`direct`) or an outlier; updates the probability of the latter."""
    total = (1.0 - part.p_outlier) * direct + part.p_outlier * outlier
    part.p_outlier *= outlier / total
    return total
