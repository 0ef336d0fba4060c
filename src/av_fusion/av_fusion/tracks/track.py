"""One target: a Bernoulli component, which exists with a probability and has a density if it does."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from av_common.track import Source
from av_fusion.identity.blade_pass import BladePassFrequency
from av_fusion.identity.kind import DRONE, Kind
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import (
    IDENTITY,
    Rows,
    Vector,
    combined,
    dot,
    offset,
    tangents,
    turn_between,
    turned,
    turned_back,
)
from av_fusion.tracks.component import ASSOCIATED, LEAST, SOUND, GaussianComponent
from av_fusion.tracks.evidence import Increment, increment
from av_fusion.tracks.likelihood import Comparison, Hearing, fits_of
from av_fusion.tracks.mixture import GaussianMixture
from av_fusion.tracks.past_state import NOW, Lag
from av_fusion.tracks.settings import FilterSettings
from av_fusion.tracks.sight import Image, compare, extents

MAX_GAP_S = 5.0  # a longer gap between measurements, or jump of the clock, starts new tracks
LARGEST_MOVE = math.cos(math.radians(4.0))  # of the direction of what counts as one place in the world
ON_RIG_SIGMA = math.radians(3.0)  # of places on the body: with speeds of rotors, the middle of what is heard of them moves
FAR_M = 5.0  # displacement of the rig after which a place has another direction


class Track:
    """A target that exists with a probability. Mirror images are components of its mixture.

    Measurements may be older than the density: they then update the present through the state at their own time (`lag`).

    Attributes:
        id: number of the track, not used again.
        began (s): capture time of its first measurement.
        time (s): for which the density is valid.
        mixture: the density.
        kind, blade_pass: what it is, and the blade-pass frequency of its sound.
        resolved: whether front and back are resolved, as of the newest estimate.
        score: of the detection that supports it in the newest image, 0 for none.

    Parameters:
        identifier: see `id`.
        time (s): capture time of the first measurement.
        births, existence: its mirror images, and the probability that there is such a target.
        on_rig: probability that it is fixed to the body.
        settings: see `FilterSettings`.
        motion: attitude and path of the rig.
    """

    def __init__(self, identifier: int, time: float, births: Sequence[GaussianComponent], existence: float,
                 settings: FilterSettings, motion: RigMotion, on_rig: float = 0.0) -> None:
        self._settings, self._motion = settings, motion
        self.id, self.began, self.time = identifier, time, time
        self._attitude = motion.attitude(time)  # of the rig at the time of the density, as it was known then
        self.mixture = GaussianMixture(births, existence, settings.model, on_rig)
        self.kind, self.blade_pass = Kind(), BladePassFrequency()
        self.score, self.resolved = 0.0, False
        # Where it would be on the rig, in the body, with variances (rad^2) across and up; and the largest square of a distance.
        self._on_rig = [(turned_back(self._attitude, one.direction), *one.covariance.diagonal()[:2])
                        for one in self.mixture.components if one.on_rig]
        self._moved_on_rig = 0.0
        self._anchor: tuple[Vector, Vector] | None = None  # direction from which it is heard while static, and the rig's place

    @property
    def existence(self) -> float:
        """Probability that the target exists."""
        return 1.0 - self.mixture.absent

    @property
    def seen(self) -> float:
        """Capture time (s) of the newest detection that supports its direction; -inf without one."""
        primary = self.mixture.primary()
        return -math.inf if primary is None else primary.newest_sighting

    @property
    def drone(self) -> float:
        """Probability that the target is a drone; NaN while nothing tells.

        That it is a part of the rig counts once it is more probable than not.
        """
        own, drone = self.mixture.on_rig, self.kind.drone
        return drone if own <= 0.5 else (1.0 - own) * (DRONE if math.isnan(drone) else drone)

    def predict(self, time: float, mirrors: Collection[Vector] = ()) -> Lag:
        """Predict to `time` (s); nothing for an earlier time.

        Returns how much earlier it is than the density, NOW after a prediction.

        Parameters:
            time (s): capture time of a measurement.
            mirrors: normals of planes at which components are split, since a measurement near them fits both sides.
        """
        dt, lag, attitude, turn = time - self.time, NOW, self._attitude, IDENTITY
        if self.mixture.on_rig:
            attitude = self._motion.attitude(time)
            turn = turn_between(self._attitude, attitude)
        if dt < 0.0:
            lag = Lag(-dt, self._motion.moved(time, self.time), turn)
        else:
            self.mixture.predict(dt, not self.kind.is_fixed, math.exp(-self._settings.loss_rate * dt),
                                 self._motion.moved(self.time, time), turn)
            self.time, self._attitude = time, attitude
        self.mixture.split_at(mirrors)
        return lag

    def later(self, time: float) -> dict[GaussianComponent, GaussianComponent]:
        """A copy of each component, predicted to `time` (s)."""
        moved, turn = self._motion.moved(self.time, time), IDENTITY
        if self.mixture.on_rig:
            turn = turn_between(self._attitude, self._motion.attitude(time))
        copies = {component: replace(component) for component in self.mixture.components}
        for copy in copies.values():
            copy.predict(time - self.time, self.mixture.model, not self.kind.is_fixed, moved, turn)
        return copies

    def compare_sound(self, time: float, heard: Sequence[Hearing], lag: Lag) -> list[Comparison]:
        """Each component compared with each direction of arrival of one window; `found` are their fits, see `audible`.

        Parameters:
            time (s): capture time.
            heard: the directions.
            lag: result of `predict`.
        """
        compared, settings = [], self._settings
        for component in self.mixture.components:
            past = component.at(lag)
            matches = [hearing.source.compare(past) for hearing in heard]
            fits = np.array([fits_of(match) for match in matches]).T
            unheard = component.p_hidden(SOUND, time, settings.unheard_rate, settings.unheard_time)
            compared.append(Comparison(component, past, matches, unheard, 1.0, fits))
        return compared

    def ratios(self, compared: Sequence[Comparison], count: int) -> NDArray[np.float64]:
        """Likelihood ratio of each measurement of a scan: that it stems from this target, over that none does, (m,).

        Parameters:
            compared: of the components with the scan.
            count: number of measurements.
        """
        none, ratios = 1.0, np.zeros(count)
        for one in compared:
            none -= one.component.weight * (1.0 - one.missed)
            ratios += one.component.weight * (one.component.modes @ one.found)
        return ratios / max(none, LEAST)

    def use_sound(self, time: float, compared: Sequence[Comparison], gains: NDArray[np.float64], free: NDArray[np.float64],
                  fraction: float) -> None:
        """Weigh and update the components by the directions of arrival of one window.

        Likelihoods are raised to the effective sample fraction, as windows overlap. Associations are those of the whole window:
        by the larger noise of its new part, what is far off would be taken for the target's.

        Parameters:
            time (s): capture time.
            compared, gains: of the components with the directions, see `audible`.
            free (m,): how far each direction is free for this target.
            fraction: effective sample fraction.
        """
        for each in compared:
            component, unheard, found = each.component, each.hidden, each.found * free
            shares = found / (each.missed + np.add.reduce(found, axis=1, keepdims=True))
            fits = np.array([fits_of(match, 1.0 / fraction) for match in each.matches]).T
            tempered = unheard + (1.0 - unheard) * ((1.0 - each.chance) ** fraction + fits @ (gains * free) ** fraction)
            total = float(component.modes @ tempered)
            component.note_hidden(SOUND, time, unheard / total)
            component.weigh_modes(tempered)
            if update_by_directions(time, False, each, shares, fraction) >= ASSOCIATED:
                component.newest_doa = max(component.newest_doa, time)
            component.weight *= total
            if component.on_rig:
                component.weight *= self._stays_on_rig(component)
        self.mixture.reduce()

    def _stays_on_rig(self, component: GaussianComponent) -> float:
        """Likelihood that what is fixed to the body was found where it is: within ON_RIG_SIGMA of where it was first heard.

        A target that the rig follows moves less relative to the body than to the world, but not so little.
        """
        place, across_variance, up_variance = self._on_rig[0]
        axes, covariance = tangents(component.azimuth, component.elevation), component.covariance
        across, up = offset(component.direction, *axes, turned(self._attitude, place))
        square = (across**2 / (across_variance + covariance[0, 0] + ON_RIG_SIGMA**2)
                  + up**2 / (up_variance + covariance[1, 1] + ON_RIG_SIGMA**2))
        before, self._moved_on_rig = self._moved_on_rig, max(self._moved_on_rig, float(square))
        return math.exp(0.5 * (before - self._moved_on_rig))

    def compare_image(self, image: Image, lag: Lag) -> list[Comparison]:
        """Each component compared with an image, which shows no part of the rig; `lag` is the result of `predict`."""
        return [compare(component, component.at(lag), image, self._settings.detection_probability)
                for component in self.mixture.components if not component.on_rig]

    def use_image(self, image: Image, compared: Sequence[Comparison], free: NDArray[np.float64]) -> None:
        """Weigh and update the components by an image.

        Parameters:
            image: the image.
            compared: of the components with it.
            free (m): how far each detection is free for this target.
        """
        for comparison in compared:
            _update_by_image(image, comparison, free, self._settings.detection_probability)
        self.mixture.reduce()

    def note_kind(self, sensor: Source, probabilities: Sequence[float], looks: Sequence[float], seconds: float = 0.0) -> None:
        """Note what the measurements of a scan tell of the kind of the target.

        Parameters:
            sensor, probabilities, looks: see `Kind.note`.
            seconds (s): for which it was heard since the scan before.
        """
        self.kind.note(sensor, probabilities, looks)
        primary = self.mixture.primary()
        if seconds <= 0.0 or primary is None or sum(looks) <= 0.0:
            return
        place, anchor = self._motion.path(self.time), self._anchor
        if (anchor is None or dot(anchor[0], primary.direction) < LARGEST_MOVE
                or math.dist(anchor[1], place) > FAR_M):
            self._anchor, self.kind.static_s = (primary.direction, place), 0.0
        self.kind.static_s += seconds

    def increment(self) -> Increment | None:
        """What its direction's measurements have added since the last call; None where there were none."""
        primary, found = self.mixture.primary(), None
        if primary is not None and not primary.on_rig:
            (across, up), (left, above) = (primary.rates(self._motion.velocity(self.time)),
                                           tangents(primary.azimuth, primary.elevation))
            found = increment(primary.evidence, combined(across, left, up, above))
        for component in self.mixture.components:
            component.evidence.clear()
        return found

    def turn_world(self, rows: Rows) -> None:
        """Turn the track with the world, where the rig's attitude was corrected."""
        self.mixture.turn_world(rows)
        self._attitude = self._motion.attitude(self.time)
        self._anchor = None


def audible(compared: Sequence[Comparison], gains: NDArray[np.float64], chance: float) -> list[Comparison]:
    """Components compared with the directions of a window, of which each has a gain.

    Parameters:
        compared: result of `Track.compare_sound`.
        gains (m,): peak likelihood of each direction from a target that can be heard, over clutter.
        chance: probability that a target that can be heard is among the directions.
    """
    return [each._replace(chance=chance, found=(1.0 - each.hidden) * each.found * gains) for each in compared]


def presence(compared: Sequence[Comparison]) -> float:
    """Probability that a target exists and is where one of the directions is, as far as its density tells places apart.

    Parameters:
        compared: result of `Track.compare_sound`.
    """
    places = [each.component.weight * (each.component.modes @ each.found) for each in compared]
    return float(sum(places, np.zeros(1)).max())


def update_by_directions(time: float, seen: bool, compared: Comparison, shares: NDArray[np.float64], fraction: float
                         ) -> float:
    """Update a component by the directions of a scan; returns the probability that one of them stems from this component.

    Parameters:
        time, seen, shares, fraction: see `GaussianComponent.update`.
        compared: of the component with the directions.
    """
    component, past, matches = compared.component, compared.past, compared.matches
    first = [one.deviations[0] if one.curve is None else one.likelier(past, component.modes, fraction) for one in matches]
    component.update(time, seen, past, first, shares, fraction, matches[0].direction is None)
    whole = component.modes @ shares
    known = [(j, one.direction) for j, one in enumerate(matches) if one.direction is not None and one.direction.is_known]
    if known:
        past, measured = component.at(past.lag), [j for j, _ in known]
        component.update(time, seen, past, [direction.deviations(past)[1] for _, direction in known], shares[:, measured],
                         fraction)
        component.elevation_measured |= bool(np.add.reduce(whole[measured]) >= ASSOCIATED)
    return float(np.add.reduce(whole))


def _update_by_image(image: Image, compared: Comparison, free: NDArray[np.float64], detected: float) -> None:
    """Weigh and update a component by an image.

    Parameters:
        image: the image.
        compared: of the component with it.
        free (m,): how far each detection is free for this target.
        detected: probability that a target in view is detected where nothing hides it.
    """
    component, missed, hidden = compared.component, compared.missed, compared.hidden
    likelihood, overlooked = missed, 1.0
    if image.directions:
        found = compared.found * free
        likelihoods = missed + np.add.reduce(found, axis=1)
        likelihood = float(component.modes @ likelihoods)
        component.weigh_modes(likelihoods)  # errors that successive images share are no motion
        if update_by_directions(image.time, True, compared, found / likelihoods[:, None], image.fraction) >= ASSOCIATED:
            component.newest_sighting = max(component.newest_sighting, image.time)
        overlooked = missed / likelihood  # what was detected is not hidden
    if overlooked > ASSOCIATED:
        _update_by_absence(image, compared, (1.0 - hidden) * detected * image.measurement.searched)
    unseen = hidden + (1.0 - hidden) * max(1.0 - compared.chance, 1e-3) ** image.fraction
    component.note_hidden(image.measurement.camera, image.time, hidden * overlooked / unseen)
    component.weight *= likelihood**image.fraction


def _update_by_absence(image: Image, compared: Comparison, seen: float) -> None:
    """Update a component by an image that does not show it: it is beyond the edges rather than within.

    The density is multiplied by the probability that the image does not show the target, as by negative information (Koch, On
    negative information in tracking and sensor data fusion, FUSION 2004), and its moments are kept.

    Parameters:
        image: the image.
        compared: the component with it.
        seen: probability that the target is detected in view.
    """
    component = compared.component
    for axis in (0, 1):  # one after the other, as both angles may be correlated
        past = component.at(compared.past.lag)
        ranges = extents(past, image.view, image.measurement)
        here = 1.0 - (1.0 - seen * ranges[1 - axis].share(past)) ** image.fraction
        angle, row, half = ranges[axis]
        component.update_moments(past, row, *past.beyond(angle, row, ((1.0, half), (-1.0, -half)), here)[1:])
