"""One of several targets: a Bernoulli component, which exists with a probability and has a density if it does."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from av_fusion.filter.ambiguity import Ambiguity
from av_fusion.filter.doa_likelihood import Comparison
from av_fusion.filter.gaussian_mixture import BirthComponent
from av_fusion.filter.hearing import Hearing
from av_fusion.filter.posterior import Posterior
from av_fusion.filter.process_noise import ONE_OF_SEVERAL, ONLY
from av_fusion.filter.target_density import Image, SightComparison
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import ZERO
from av_fusion.multi_target.blade_pass import BladePassFrequency
from av_fusion.multi_target.drone_evidence import DRONE, DroneEvidence
from av_fusion.multi_target.identity import overlap
from av_fusion.multi_target.settings import MultiTargetSettings

MANOEUVRE_GATE = 25.0  # see `TargetDensity`


class BernoulliTrack(Posterior):
    """A target that exists with a probability. The background of its mixture is the probability that it does not.

    Mirror images are components of the mixture. `p_outlier` of a component is the probability that the target cannot be heard.

    Attributes:
        id: number of the track, not used again.
        began (s): time of its first measurement.
        score: that of the detection that supports it in the newest image, 0 for none.
        kind: evidence of what it is.
        blade_pass: blade-pass frequency of its sound.
        confusions: largest probability so far that it was taken for another target, by the id of that.
        ambiguity: whether front and back are told apart.
        told_apart: newest time (s), by the id of another track, at which the two had different measurements in a scan.
        reported: whether it has existed more probably than not.

    Parameters:
        identifier: see `id`.
        time (s): capture time of its first measurement.
        settings: see `MultiTargetSettings`.
        motion: attitude and path of the rig.
    """

    def __init__(self, identifier: int, time: float, settings: MultiTargetSettings, motion: RigMotion) -> None:
        super().__init__(settings.target, motion)
        self._multi = settings
        self.id, self.began = identifier, time
        self.score = 0.0
        self.kind = DroneEvidence()
        self.blade_pass = BladePassFrequency()
        self.confusions: dict[int, float] = {}
        self.ambiguity = Ambiguity(settings.target.confirm_threshold, settings.target.release_threshold)
        self.told_apart: dict[int, float] = {}
        self.reported = False
        self.time = time
        self._steady = settings.target.model._replace(acceleration_density=settings.acceleration_density,
                                                      elevation_density=settings.elevation_density)

    @property
    def existence(self) -> float:
        """Probability that the target exists."""
        return min(max(1.0 - self.mixture.background, 0.0), 1.0)

    @property
    def is_drone(self) -> bool:
        """Whether it is more likely a drone than not, or not judged."""
        return not self.kind.probability < DRONE

    @property
    def identity(self) -> float:
        """Probability that this is still the target that was given its id."""
        return math.prod((1.0 - confusion for confusion in self.confusions.values()), start=1.0)

    def assume_alone(self, alone: bool) -> None:
        """Assume ordinary motion of the only target, and steady motion of several, by which they are told apart."""
        self.mixture.model = self._settings.model if alone else self._steady
        self.mixture.rate_variance = (self._settings.rate_sigma if alone else self._multi.rate_sigma) ** 2
        self.process_noise.adaptation = ONLY if alone else ONE_OF_SEVERAL
        self.manoeuvre_gate = math.inf if alone else MANOEUVRE_GATE

    def compare_identity(self, other: BernoulliTrack) -> None:
        """Note how probable it is that this target and another one are taken for each other."""
        one, two = self.mixture.primary(), other.mixture.primary()
        if one is not None and two is not None:
            alike = overlap(one, two)
            confusion = 0.5 * alike * self.blade_pass.overlap(other.blade_pass) if alike else 0.0
            for track, rival in ((self, other), (other, self)):
                track.confusions[rival.id] = max(track.confusions.get(rival.id, 0.0), confusion)

    def begin(self, births: Sequence[BirthComponent], existence: float) -> None:
        """Start beside others with components, whose shares are their ratios.

        Parameters:
            births: directions at the track's time.
            existence: probability of existence.
        """
        self.assume_alone(False)
        total = sum([birth.ratio for birth in births])
        self.mixture.background = 1.0
        self.mixture.add_births(0.0, self.process_noise.value, ZERO, [
            birth._replace(ratio=existence * birth.ratio / total, gates=lambda past: False) for birth in births])
        self.mixture.background = 1.0 - existence
        self.mixture.reduce()

    def renew(self, identifier: int, time: float) -> None:
        """Become a target that is not known yet: as the only one that was lost, and may be anywhere, or another one."""
        self.id, self.began = identifier, time
        self.kind, self.blade_pass = DroneEvidence(), BladePassFrequency()
        self.confusions, self.told_apart = {}, {}
        self.ambiguity.resolved = self.reported = False

    def predict_heard(self, seconds: float) -> None:
        """Predict by `seconds` whether the target can be heard, a two-state Markov chain."""
        rate, kept = self._multi.unheard_rate, math.exp(-seconds / self._multi.unheard_time)
        for component in self.mixture.components:
            component.p_outlier = rate + kept * (component.p_outlier - rate)

    def sound_ratios(self, compared: Sequence[Sequence[Comparison]], heard: Sequence[Hearing]) -> NDArray[np.float64]:
        """Likelihood ratio of each direction of arrival: that it stems from this target, over that none does, (m,).

        Parameters:
            compared: of the components with the directions.
            heard: the directions.
        """
        detected = self._multi.sound_detection_probability
        none = self.mixture.background
        ratios = np.zeros(len(heard))
        for comparisons in compared:
            component = comparisons[0].component
            audible = component.weight * (1.0 - component.p_outlier)
            none += component.weight - audible * detected
            ratios += audible * np.array([comparison.fit for comparison in comparisons])
        return ratios * _gains(heard, detected) / none

    def use_sound(self, time: float, compared: Sequence[Sequence[Comparison]], heard: Sequence[Hearing],
                  free: NDArray[np.float64], fraction: float) -> None:
        """Weigh and update the components by the directions of arrival of one window.

        Likelihoods are raised to the effective sample fraction, as windows overlap; associations are those of this window.

        Parameters:
            time (s): capture time.
            compared: of the components with the directions.
            heard: the directions.
            free (m,): how far each is free for this target.
            fraction: effective sample fraction.
        """
        self.newest_doa = max(self.newest_doa, time)
        missed = 1.0 - self._multi.sound_detection_probability
        gains = _gains(heard, 1.0 - missed) * free
        for comparisons in compared:
            component = comparisons[0].component
            fits = np.array([comparison.fit for comparison in comparisons])
            direct, unheard = missed**fraction + float(np.sum(fits * gains**fraction)), component.p_outlier
            total = unheard + (1.0 - unheard) * direct
            component.p_outlier = unheard / total
            likelihoods = (1.0 - unheard) * fits * gains
            shares = likelihoods / (unheard + (1.0 - unheard) * missed + float(likelihoods.sum()))
            for comparison, share in zip(comparisons, shares.tolist(), strict=True):
                self.note_innovation(comparison, fraction, share)
            self.update_by_sound(time, comparisons, shares.tolist())
            component.weight *= total
        self.adapt_to_sound(fraction)
        self.mixture.reduce()

    def miss_sound(self, fraction: float) -> None:
        """Weigh the components by a window without any direction of arrival; `fraction` is its effective sample fraction."""
        missed = (1.0 - self._multi.sound_detection_probability) ** fraction
        for component in self.mixture.components:
            total = component.p_outlier + (1.0 - component.p_outlier) * missed
            component.p_outlier /= total
            component.weight *= total
        self.mixture.reduce()

    def image_ratios(self, compared: Sequence[SightComparison], count: int) -> NDArray[np.float64]:
        """Likelihood ratio of each detection: that it is this target, over that none is, (m,).

        Parameters:
            compared: of the components with the image.
            count: number of detections.
        """
        none, ratios = self.mixture.background, np.zeros(count)
        for comparison in compared:
            none += comparison.component.weight * comparison.missed
            ratios += comparison.component.weight * np.array(comparison.found)
        return ratios / none

    def use_image(self, image: Image, compared: Sequence[SightComparison], free: NDArray[np.float64]) -> None:
        """Weigh and update the components by an image.

        Parameters:
            image: the image.
            compared: of the components with it.
            free (m,): how far each detection is free for this target.
        """
        self.newest_image = max(self.newest_image, image.time)
        primary, self.score = self.mixture.primary(), 0.0
        factors = free.tolist()
        for comparison in compared:
            supporting = self.update_by_image(image, comparison, factors)
            self.score = supporting if comparison.component is primary else self.score
        if image.directions:
            self.adapt_to_sight(image.fraction)
        if self.score > 0.0:
            self.newest_sighting = max(self.newest_sighting, image.time)
        self.mixture.reduce()


def _gains(heard: Sequence[Hearing], detected: float) -> NDArray[np.float64]:
    """Peak likelihoods (m,) of directions of arrival from a target over clutter, with its detection probability."""
    return np.array([detected * hearing.peak / hearing.clutter for hearing in heard])
