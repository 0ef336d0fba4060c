"""The density of one target at one time: Gaussian components, and the probability that there is no such target."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import replace
from math import remainder, tau
from operator import attrgetter

import numpy as np

from av_fusion.measurement.vectors import Rows, Vector, dot, offset, tangents
from av_fusion.tracks.component import LEAST, GaussianComponent
from av_fusion.tracks.motion import MotionModel

AGREEING = math.radians(10.0)  # components closer together are one direction
PRIMARY_RATIO = 1.5  # weight of another component, relative to the primary one, from which it becomes primary
_WEIGHT = attrgetter('weight')


class GaussianMixture:
    """Gaussian components, whose weights and `absent` sum to one after `reduce`. It begins with one measurement.

    Attributes:
        components: the Gaussians.
        on_rig: probability that the target, if there is one, is fixed to the body.
        absent: probability that there is no such target.

    Parameters:
        births: mirror images of the measurement, with their probabilities among each other as weights.
        existence: probability that there is such a target.
        model: motion of targets.
        on_rig: probability that it is fixed to the body. Its mirror images are one there, as none ever fits better.
    """

    def __init__(self, births: Sequence[GaussianComponent], existence: float, model: MotionModel, on_rig: float) -> None:
        self.model, self.absent = model, 1.0 - existence
        self._primary: GaussianComponent | None = None
        self.components = list(births)
        if on_rig > 0.0:
            own = replace(max(births, key=_WEIGHT), weight=on_rig / (1.0 - on_rig), on_rig=True, evidence=deque())
            self.components.append(own)
        for component in self.components:
            component.weight *= existence * (1.0 - on_rig)
        self.reduce()

    def predict(self, dt: float, moving: bool, kept: float, moved: Vector, turn: Rows) -> None:
        """Predict every component by `dt` s; the target disappears with the probability 1 - `kept`.

        Parameters:
            dt (s): duration of the prediction.
            moving: whether the target accelerates at all.
            kept: probability that the target is still present.
            moved (m), turn: displacement and rotation of the rig meanwhile, in the world.
        """
        for component in self.components:
            component.predict(dt, self.model, moving, moved, turn)
            component.weight *= kept
        self.absent += (1.0 - kept) * (1.0 - self.absent)

    def split_at(self, mirrors: Collection[Vector]) -> None:
        """Split components that extend to both sides of planes, given by their unit normals in the world."""
        for normal in mirrors:
            self.components = [part for component in self.components
                               for part in ([component] if component.on_rig else split(component, normal))]

    def weigh_by_cue(self, cue: Vector, variance: float, wrong: float) -> None:
        """Weigh the components among each other by where others say that a target is.

        The cue decides between hypotheses: it moves no component, makes none more precise, and says nothing about whether there
        is a target. With the probability `wrong` it concerns another target, which may be anywhere.

        Parameters:
            cue: unit vector in the world.
            variance (rad^2): of its direction along each axis.
            wrong: probability that it concerns another target.
        """
        components = [component for component in self.components if not component.on_rig]
        total = sum([component.weight for component in components])
        for component in components:
            apart = np.array(component.at().offset(cue))
            S = component.covariance[:2, :2] + variance * np.eye(2)
            density = math.exp(-0.5 * float(apart @ np.linalg.solve(S, apart))) / (tau * math.sqrt(float(np.linalg.det(S))))
            component.weight *= wrong + (1.0 - wrong) * density * 2.0 * tau
        changed = sum([component.weight for component in components])
        for component in components:
            component.weight *= total / changed

    def turn_world(self, rows: Rows) -> None:
        """Turn all components with the world, where the rig's attitude was corrected."""
        for component in self.components:
            component.turn_world(rows)

    def reduce(self) -> None:
        """Normalise, merge components that agree, and remove those of little weight."""
        components = sorted(self.components, key=_WEIGHT, reverse=True)
        total = self.absent + sum([component.weight for component in components])
        kept: list[GaussianComponent] = []
        self.components = kept
        self.absent /= total
        for component in components:
            component.weight /= total
            for other in kept:
                if are_mergeable(other, component):
                    merge(other, component)
                    break
            else:
                if component.weight >= LEAST:
                    kept.append(component)
                else:
                    self.absent += component.weight
        self.absent = max(self.absent, LEAST)
        whole = sum([component.weight for component in kept])
        self.on_rig = sum([component.weight for component in kept if component.on_rig]) / whole if kept else 0.0

    @property
    def likely(self) -> list[GaussianComponent]:
        """The components of what is the more probable: that the target is fixed to the body, or that it is not."""
        own = self.on_rig > 0.5
        return [component for component in self.components if component.on_rig == own]

    def primary(self) -> GaussianComponent | None:
        """The heaviest component of the likely ones; the previous one is kept until another is clearly heavier."""
        likely, previous = self.likely, self._primary
        heaviest = max(likely, key=_WEIGHT, default=None)
        if (heaviest is None or previous is None or previous not in likely
                or heaviest.weight > PRIMARY_RATIO * previous.weight):
            self._primary = heaviest
        return self._primary

    @property
    def entropy(self) -> float:
        """Of the direction if there is a target, in nats and without a constant: an upper bound.

        Huber et al., On entropy approximation for Gaussian mixture random vectors, MFI 2008.
        """
        likely = [component for component in self.components if component.weight > 0.0]
        whole = sum([component.weight for component in likely])
        return sum([component.weight / whole * (0.5 * math.log(np.linalg.det(component.covariance[:2, :2]))
                                                - math.log(component.weight / whole)) for component in likely])

    def share_of(self, primary: GaussianComponent) -> float:
        """Probability of the direction of the primary component, given that there is a target: of all that agree with it."""
        agreeing = total = 0.0
        for component in [one for one in self.components if one.on_rig == primary.on_rig]:
            total += component.weight
            apart = min(abs(remainder(primary.azimuth - component.azimuth, tau)),  # at the zenith azimuths mean little
                        math.acos(min(max(dot(primary.direction, component.direction), -1.0), 1.0)))
            agreeing += component.weight * (apart < AGREEING)
        return agreeing / total


def split(component: GaussianComponent, normal: Vector) -> list[GaussianComponent]:
    """A component split in two if it extends to both sides of a plane between mirror images, else alone.

    A measurement of a target near that plane fits both sides, which one Gaussian cannot represent. The parts are truncated
    normal distributions, approximated by Gaussians.

    Parameters:
        component: the component.
        normal: unit vector in the world, perpendicular to the plane.
    """
    past = component.at()
    beside, row = past.above_plane(normal)
    if abs(math.sin(beside)) > 1.3 * math.sqrt(past.variance(row)):  # less than a tenth beyond the plane
        return [component]
    parts = []
    for side in (1.0, -1.0):
        left, shifts, changes = past.beyond(beside, row, ((side, 0.0),), 1.0 - 1e-12)
        part = replace(component, weight=component.weight * float(component.modes @ left), evidence=component.evidence.copy())
        part.weigh_modes(left)
        part.update_moments(past, row, shifts, changes)
        parts.append(part)
    return parts


def are_mergeable(one: GaussianComponent, other: GaussianComponent) -> bool:
    """Whether direction and rates of both agree within their standard deviations, so that their sum has one peak."""
    if one.on_rig != other.on_rig:
        return False
    across, up = _offset(one, other)
    variances = one.covariance.diagonal() + other.covariance.diagonal()
    return bool(across**2 < variances[0] and up**2 < 2.0 * variances[1]
                and (other.across_rate - one.across_rate) ** 2 < variances[2]
                and (other.up_rate - one.up_rate) ** 2 < 9.0 * variances[3])


def merge(one: GaussianComponent, other: GaussianComponent) -> None:
    """Merge another component into one, preserving the moments of the sum; the heavier one's support is kept."""
    if other.weight > one.weight:
        one.newest_doa, one.newest_sighting, one.evidence = other.newest_doa, other.newest_sighting, other.evidence
    total = one.weight + other.weight
    a, b = one.weight / total, other.weight / total
    across, up = _offset(one, other)
    here = replace(other)
    here.move(*_offset(other, one))
    difference = np.array([across, up, here.across_rate - one.across_rate, here.up_rate - one.up_rate,
                           here.inverse_range - one.inverse_range])
    modes = a * one.modes + b * here.modes
    share = (b * here.modes / modes)[:, None]
    apart = here.offsets + difference - one.offsets
    spread = (share * (1.0 - share) * apart)[:, :, None] * apart[:, None, :]
    one.covariances = (1.0 - share)[..., None] * one.covariances + share[..., None] * here.covariances + spread
    one.offsets, one.modes = one.offsets + share * apart, modes
    one.elevation_measured = one.elevation_measured or other.elevation_measured
    one.weight = total
    one.recentre()


def _offset(one: GaussianComponent, other: GaussianComponent) -> tuple[float, float]:
    """Where the mean of another component is in the plane of one, across and up (rad)."""
    return offset(one.direction, *tangents(one.azimuth, one.elevation), other.direction)
