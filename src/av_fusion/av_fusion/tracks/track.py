"""One target: a Bernoulli component, which exists with a probability and has a density if it does."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

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
from av_fusion.tracks.component import ASSOCIATED, GaussianComponent
from av_fusion.tracks.evidence import Increment, increment
from av_fusion.tracks.hearing import Hearing
from av_fusion.tracks.likelihood import Comparison, Deviation, fits_of
from av_fusion.tracks.mixture import GaussianMixture
from av_fusion.tracks.past_state import NOW, Alternatives, Lag, PastState
from av_fusion.tracks.settings import FilterSettings
from av_fusion.tracks.sight import Image, SightComparison, compare, extents

MAX_GAP_S = 5.0  # a longer gap between measurements, or jump of the clock, starts new tracks
LEAST_LIKELIHOOD = 1e-3  # of an image under a component
LEAST_ELEVATION_ASSOCIATION = 0.05  # probability below which an elevation is not used
LARGEST_MOVE = math.cos(math.radians(4.0))  # of the direction of what counts as one place in the world
ON_RIG_SIGMA = math.radians(3.0)  # of places on the body: with speeds of rotors, the middle of what is heard of them moves
FAR_M = 5.0  # displacement of the rig after which a place has another direction


class SoundComparison(NamedTuple):
    """A component compared with the directions of arrival of one window.

    Parameters:
        component, past: the component, and its direction at the capture time.
        directions: compared with each direction.
        fits (k, m): of each in each mode of motion, see `fits_of`, by the noise of the new part of the window.
        own (k, m): the same by the noise of the whole window.
    """

    component: GaussianComponent
    past: PastState
    directions: Sequence[Comparison]
    fits: NDArray[np.float64]
    own: NDArray[np.float64]


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
        return min(max(1.0 - self.mixture.absent, 0.0), 1.0)

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

    def predict(self, time: float, axes: Collection[Vector] = ()) -> Lag:
        """Predict to `time` (s); nothing for an earlier time.

        Returns how much earlier it is than the density, NOW after a prediction.

        Parameters:
            time (s): capture time of a measurement.
            axes: at which components are split, since a measurement near end-fire fits both sides.
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
        self.mixture.split_at(axes)
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

    def predict_heard(self, seconds: float) -> None:
        """Predict by `seconds` whether the target can be heard, a two-state Markov chain."""
        rate, kept = self._settings.unheard_rate, math.exp(-seconds / self._settings.unheard_time)
        for component in self.mixture.components:
            component.p_unheard = rate + kept * (component.p_unheard - rate)

    def compare_sound(self, heard: Sequence[Hearing], lag: Lag, fraction: float) -> list[SoundComparison]:
        """Each component compared with each direction of arrival of one window.

        Parameters:
            heard: the directions.
            lag: result of `predict`.
            fraction: effective sample fraction of the window.
        """
        compared = []
        for component in self.mixture.components:
            past = component.at(lag)
            directions = [hearing.source.compare(past) for hearing in heard]
            fits = np.array([fits_of(direction.deviations, 1.0 / fraction) for direction in directions]).T
            own = np.array([fits_of(direction.deviations) for direction in directions]).T
            compared.append(SoundComparison(component, past, directions, fits, own))
        return compared

    @staticmethod
    def presence(compared: Sequence[SoundComparison]) -> float:
        """Probability that it exists and is where one of the directions is, as far as its density tells places apart.

        Parameters:
            compared: of the components with the directions.
        """
        places = [each.component.weight * (each.component.modes @ each.fits) for each in compared]
        return float(np.max(sum(places, np.zeros(1))))

    def sound_ratios(self, compared: Sequence[SoundComparison], gains: NDArray[np.float64], missed: float
                     ) -> NDArray[np.float64]:
        """Likelihood ratio of each direction of arrival: that it stems from this target, over that none does, (m,).

        Parameters:
            compared: of the components with the directions.
            gains (m,): peak likelihood of each direction from a target that can be heard, over clutter.
            missed: probability that the target is not among the directions although it can be heard.
        """
        none, ratios = self.mixture.absent, np.zeros(len(gains))
        for component, _, _, _, own in compared:
            audible = component.weight * (1.0 - component.p_unheard)
            none += component.weight - audible * (1.0 - missed)
            ratios += audible * (component.modes @ own)
        return ratios * gains / none

    def use_sound(self, time: float, compared: Sequence[SoundComparison], gains: NDArray[np.float64], missed: float,
                  fraction: float) -> None:
        """Weigh and update the components by the directions of arrival of one window.

        Likelihoods are raised to the effective sample fraction, as windows overlap. Associations are those of the whole window:
        by the larger noise of its new part, what is far off would be taken for the target's.

        Parameters:
            time (s): capture time.
            compared: of the components with the directions.
            gains (m,): see `sound_ratios`, times how far each direction is free for this target.
            missed: see `sound_ratios`.
            fraction: effective sample fraction.
        """
        tempered = gains**fraction
        for each in compared:
            component, fits = each.component, each.fits
            unheard = component.p_unheard
            totals = unheard + (1.0 - unheard) * (missed**fraction + fits @ tempered)
            likelihoods = (1.0 - unheard) * each.own * gains
            shares = likelihoods / (unheard + (1.0 - unheard) * missed + np.add.reduce(likelihoods, axis=1, keepdims=True))
            total = float(component.modes @ totals)
            component.p_unheard = unheard / total
            component.weigh_modes(totals)
            whole = update_by_directions(time, False, component, each.past, each.directions, shares, fraction)
            if sum(whole) >= ASSOCIATED:
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

    def predict_hidden(self, image: Image) -> None:
        """Predict to an image whether the target is hidden from the camera."""
        for component in self.mixture.components:
            component.predict_hidden(image.measurement.camera, image.time, image.visibility, image.is_known)

    def compare_image(self, image: Image, lag: Lag) -> list[SightComparison]:
        """Each component compared with an image, which shows no part of the rig; `lag` is the result of `predict`."""
        return [compare(component, component.at(lag), image, self._settings.detection_probability)
                for component in self.mixture.components if not component.on_rig]

    def image_ratios(self, compared: Sequence[SightComparison], count: int) -> NDArray[np.float64]:
        """Likelihood ratio of each detection: that it is this target, over that none is, (m,).

        Parameters:
            compared: of the components with the image.
            count: number of detections.
        """
        none, ratios = self.mixture.absent, np.zeros(count)
        none += sum([component.weight for component in self.mixture.components if component.on_rig])
        for comparison in compared:
            none += comparison.component.weight * comparison.missed
            ratios += comparison.component.weight * (comparison.component.modes @ comparison.found)
        return ratios / none

    def use_image(self, image: Image, compared: Sequence[SightComparison], free: NDArray[np.float64]) -> None:
        """Weigh and update the components by an image.

        Parameters:
            image: the image.
            compared: of the components with it.
            free (m): how far each detection is free for this target.
        """
        primary, self.score = self.mixture.primary(), 0.0
        for comparison in compared:
            score = _update_by_image(image, comparison, free, self._settings.detection_probability)
            self.score = score if comparison.component is primary else self.score
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


def update_by_directions(time: float, seen: bool, component: GaussianComponent, past: PastState,
                         directions: Sequence[Comparison], shares: NDArray[np.float64], fraction: float) -> list[float]:
    """Update a component by the directions of a scan; returns the probability of each that it stems from this component.

    Parameters:
        time (s): their capture time.
        seen: whether by the camera.
        component, past: the component, and its direction at the capture time.
        directions: compared with it.
        shares (k, m): probability of each in each mode that it stems from this component; they sum to at most one.
        fraction: effective sample fraction. Only the evidence that is kept of images is weakened by it: their errors are
            alike, so that together they say less than the filter, which moves on, makes of each.
    """
    across, is_cone = [one.deviations[0] for one in directions], directions[0].direction is None
    _update(time, seen, component, past, across, shares, fraction, is_cone)
    known = [(j, one.direction) for j, one in enumerate(directions) if one.direction is not None and one.direction.is_known]
    theirs = shares[:, [j for j, _ in known]]
    if np.add.reduce(component.modes @ theirs) > LEAST_ELEVATION_ASSOCIATION:
        past = component.at(past.lag)
        _update(time, seen, component, past, [direction.deviations(past)[1] for _, direction in known], theirs, fraction)
        component.elevation_measured = True
    return np.asarray(component.modes @ shares).tolist()


def _update(time: float, seen: bool, component: GaussianComponent, past: PastState, deviations: Sequence[Deviation],
            shares: NDArray[np.float64], fraction: float, keep_elevation: bool = False) -> None:
    """Update a component by alternative values of one quantity; see `update_by_directions` and `GaussianComponent.update`."""
    row = deviations[int(np.argmax(component.modes @ shares))].row  # those of directions far away differ
    noises = np.array([one.noise for one in deviations])
    curved = np.array([np.maximum(one.totals - past.variances(one.row) - one.noise, 0.0) for one in deviations]).T
    alternatives = Alternatives(np.array([one.innovations for one in deviations]).T, curved + noises / fraction, shares)
    component.accept(time, seen, past, row, alternatives)
    component.update(past, row, alternatives._replace(variances=curved + noises) if seen else alternatives, keep_elevation)


def _update_by_image(image: Image, compared: SightComparison, free: NDArray[np.float64], detected: float) -> float:
    """Weigh and update a component by an image; the score of the detection that supports it, 0 if none does.

    Parameters:
        image: the image.
        compared: of the component with it.
        free (m,): how far each detection is free for this target.
        detected: probability that a target in view is detected where nothing hides it.
    """
    component, likelihood, score, hidden = compared.component, compared.missed, 0.0, 1.0
    visible = 1.0 - component.p_hidden(image.measurement.camera)
    if image.directions:
        found = compared.found * free
        likelihoods = compared.missed + np.add.reduce(found, axis=1)
        shares, likelihood = found / likelihoods[:, None], float(component.modes @ likelihoods)
        component.weigh_modes(likelihoods)  # errors that successive images share are no motion
        whole = update_by_directions(image.time, True, component, compared.past, compared.directions, shares, image.fraction)
        score = max((d.score for d, share in zip(image.measurement.detections, whole, strict=True) if share > ASSOCIATED),
                    default=0.0)
        if sum(whole) >= ASSOCIATED:
            component.newest_sighting = max(component.newest_sighting, image.time)
        hidden = compared.missed / likelihood  # what was detected is not hidden
    if hidden > ASSOCIATED and visible > 0.0:
        _update_by_absence(image, compared, visible * detected * image.measurement.searched)
    component.update_hidden(image.measurement.camera, compared.chance, image.fraction, hidden)
    component.weight *= max(likelihood, LEAST_LIKELIHOOD) ** image.fraction
    return score


def _update_by_absence(image: Image, compared: SightComparison, seen: float) -> None:
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
