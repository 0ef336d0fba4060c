"""One model of a rig's set-up: what sound and sight of one target measure, by what may be wrong with their description.

The state of a hypothesis holds the target's motion and the parameters of the set-up. A hypothesis differs from another by its
prior of these parameters (how far each may be off) and by three signs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap

TARGET, TARGET_RATE, OTHER, OTHER_RATE, BIAS, CAMERA_YAW, CAMERA_LATE, DELAY, SPACING, FOCAL, TRAVEL = range(11)
SIZE = 11
# Errors that a careful description still has: of the camera's yaw (rad), its stamps (s), the delay between the microphones as
# a cosine, and the logarithms of spacing and focal length. Self-calibration learns what remains.
CAREFUL = {CAMERA_YAW: math.radians(2.0), CAMERA_LATE: 0.03, DELAY: 0.02, SPACING: 0.04, FOCAL: 0.1}
TRAVEL_S, TRAVEL_SIGMA_S = 0.1, 0.1  # time that sound takes, over distances of some 10 to 70 m
# Directions of arrival err together for some time, by reflections and by the housing: an Ornstein-Uhlenbeck process.
BIAS_SIGMA, BIAS_TIME_S = 0.05, 2.0  # of a cosine
# Multirotors accelerate by 3 to 6 m/s^2: 8 deg/s^2 at 30 m, for about a second (Singer 1970, whose density is 2 sigma^2 tau).
ACCELERATION_DENSITY = 2.0 * math.radians(8.0) ** 2 * 1.0  # rad^2/s^3
ADAPTATION, LARGEST_SQUARE, MOST_MANOEUVRE = 0.05, 25.0, 300.0  # of the density, by one sighting; normalised square; factor
RATE_SIGMA = math.radians(15.0)  # rad/s, of a target that was just found
YAW_DELAYS_S = np.arange(-0.5, 1.05, 0.1)  # at which the heading is looked up for cameras whose stamps are wrong
SIGHT_CLUTTER, SOUND_CLUTTER = 0.05, 0.1  # probability that a measurement stems from nothing of what is modelled


SWAPPED, MIRRORED, REVERSED_YAW = 'swapped', 'mirrored', 'reversed yaw'  # signs that may be wrong


@dataclass(frozen=True)
class Hypothesis:
    """What may be wrong with the description of a rig.

    Parameters:
        prior: probability before any measurement.
        signs: which are wrong: the channels are exchanged; the image is mirrored or upside down; the yaw of odometry.
        sigmas: prior standard deviations of the parameters that are off, by their index.
        other: sound stems from another source than sight: on the side of the first (1) or second (2) mirror image; 0 if not.
    """

    prior: float
    signs: tuple[str, ...] = ()
    sigmas: Mapping[int, float] = field(default_factory=dict)
    other: int = 0

    @property
    def is_fault(self) -> bool:
        """Whether the description is wrong by this hypothesis."""
        return bool(self.signs or self.sigmas)


class SightEvent(NamedTuple):
    """A sighting.

    Parameters:
        ray: unit vector (3) in the camera (x along its axis, y left, z up).
        view: rotation (3 x 3) of the camera on the body.
        level: rotation (3 x 3) of the body against a level body of the same heading.
        yaws (rad): headings YAW_DELAYS_S before its stamp, unwrapped.
        variance (rad^2): of its azimuth.
        half_view (rad): half of the field of view.
    """

    ray: NDArray
    view: NDArray
    level: NDArray
    yaws: NDArray
    variance: float
    half_view: float


class SoundEvent(NamedTuple):
    """A window of sound.

    Parameters:
        axis: unit vector (3) in the body.
        cosines: (n) measured, of all directions of the window.
        variance: of a cosine.
        images (rad): azimuths (2) of the first direction's mirror images in the body.
        level: as of `SightEvent`.
        yaw (rad), yaw_rate (rad/s): heading.
        window (s): length of the window.
    """

    axis: NDArray
    cosines: NDArray
    variance: float
    images: NDArray
    level: NDArray
    yaw: float
    yaw_rate: float
    window: float


@dataclass
class FilterBank:
    """An extended Kalman filter for each hypothesis, and the logarithm of its evidence (Magill 1965).

    A measurement may be clutter: it enters with the probability that it is none (Bar-Shalom, probabilistic data association).

    The target's angle is that at the capture of what the camera has just sent, CAMERA_LATE before its stamp.

    Attributes:
        mean: (h, SIZE); covariance: (h, SIZE, SIZE); evidence: (h) logarithms.

    Parameters:
        hypotheses: h hypotheses.
    """

    hypotheses: tuple[Hypothesis, ...]
    mean: NDArray = field(init=False)
    covariance: NDArray = field(init=False)
    evidence: NDArray = field(init=False)

    def __post_init__(self) -> None:
        number = len(self.hypotheses)
        self.mean, self.covariance = np.zeros((number, SIZE)), np.zeros((number, SIZE, SIZE))
        self.evidence = np.log([h.prior for h in self.hypotheses])
        for k, hypothesis in enumerate(self.hypotheses):
            for index, sigma in CAREFUL.items():
                self.covariance[k, index, index] = hypothesis.sigmas.get(index, sigma) ** 2
        self.covariance[:, BIAS, BIAS] = BIAS_SIGMA**2
        self.mean[:, TRAVEL], self.covariance[:, TRAVEL, TRAVEL] = TRAVEL_S, TRAVEL_SIGMA_S**2
        self._channel, self._mirror, self._turn = (
            np.array([-1.0 if sign in h.signs else 1.0 for h in self.hypotheses]) for sign in (SWAPPED, MIRRORED, REVERSED_YAW))
        self._other = np.array([h.other for h in self.hypotheses])
        self._elevation, self._manoeuvre = 0.0, 1.0
        self.turn_world()

    def forget_target(self) -> None:
        """A new target begins; what is known of the set-up stays."""
        self._forget(TARGET)
        self._target_known = False

    def turn_world(self) -> None:
        """The heading was corrected: nothing is known of where things are, but of the set-up."""
        self.forget_target()
        self._forget(OTHER)
        self._other_known = False

    def _forget(self, angle: int) -> None:
        """Forget an angle and its rate, which follows it."""
        self.covariance[:, angle:angle + 2, :] = 0.0
        self.covariance[:, :, angle:angle + 2] = 0.0
        self.mean[:, angle + 1] = 0.0
        self.covariance[:, angle, angle], self.covariance[:, angle + 1, angle + 1] = math.pi**2, RATE_SIGMA**2

    def predict(self, seconds: float) -> None:
        """Let time pass (s)."""
        step = np.eye(SIZE)
        step[TARGET, TARGET_RATE] = step[OTHER, OTHER_RATE] = seconds
        step[BIAS, BIAS] = math.exp(-seconds / BIAS_TIME_S)
        noise = np.zeros((SIZE, SIZE))
        growth = ACCELERATION_DENSITY * np.array([[seconds**3 / 3.0, seconds**2 / 2.0], [seconds**2 / 2.0, seconds]])
        noise[OTHER:OTHER_RATE + 1, OTHER:OTHER_RATE + 1] = growth
        noise[BIAS, BIAS] = BIAS_SIGMA**2 * (1.0 - step[BIAS, BIAS] ** 2)
        self.mean = self.mean @ step.T
        self.covariance = step @ self.covariance @ step.T + noise
        # How much a target manoeuvres, as seen, is no evidence for a scale of angles: its distance is not known.
        scale = self._manoeuvre * np.exp(2.0 * self.mean[:, FOCAL])
        self.covariance[:, TARGET:TARGET_RATE + 1, TARGET:TARGET_RATE + 1] += scale[:, None, None] * growth

    def see(self, event: SightEvent) -> None:
        """Use a sighting."""
        azimuth, elevation = self._seen(event, self.mean[:, FOCAL])
        nearby, _ = self._seen(event, self.mean[:, FOCAL] + 0.01)
        self._elevation = float(elevation[0])
        late = self.mean[:, CAMERA_LATE]
        yaws = self._turn * np.interp(late, YAW_DELAYS_S, event.yaws)
        turning = self._turn * (np.interp(late + 0.05, YAW_DELAYS_S, event.yaws) -
                                np.interp(late - 0.05, YAW_DELAYS_S, event.yaws)) / 0.1
        expected = self.mean[:, TARGET] - yaws
        if not self._target_known:
            self.mean[:, TARGET] += wrap(azimuth - expected)
            expected = azimuth
        slopes = np.zeros_like(self.mean)
        slopes[:, TARGET], slopes[:, CAMERA_YAW], slopes[:, CAMERA_LATE] = 1.0, -1.0, -turning
        slopes[:, FOCAL] = -wrap(nearby - azimuth) / 0.01
        left = wrap(azimuth - expected)[:, None]
        scale = np.exp(self.mean[:, FOCAL])    # of angles: the density is that of the angle as it was measured
        variance = event.variance * scale**2
        if self._target_known:
            self._adapt(left[:, 0], slopes, variance)
        share = self._update(left, slopes, variance, SIGHT_CLUTTER, 0.5 / event.half_view, self._target_known, scale)
        self._target_known = True
        if share.max() < 0.5:  # by no hypothesis is it the target of before
            self.forget_target()

    def hear(self, event: SoundEvent) -> None:
        """Use a window of sound, in which one direction at most is the target's."""
        if not self._other_known:
            image = np.where(self._other == 2, event.images[-1], event.images[0])
            self.mean[:, OTHER] = image + self._turn * event.yaw
        rows, whose = np.arange(len(self.mean)), np.where(self._other > 0, OTHER, TARGET)
        travel = self.mean[:, TRAVEL] - np.where(self._other > 0, 0.0, self.mean[:, CAMERA_LATE])
        rate = self.mean[rows, whose + 1]
        across = self.mean[rows, whose] - rate * travel - self._turn * event.yaw
        cosine, sine, up = np.cos(across), np.sin(across), self._elevation
        flat = math.cos(up) * np.stack([cosine, sine, np.full_like(cosine, math.tan(up))], axis=1)
        aside = math.cos(up) * np.stack([-sine, cosine, np.zeros_like(cosine)], axis=1)
        axis = event.level @ event.axis
        scale = self._channel * np.exp(self.mean[:, SPACING])
        along = scale * (flat @ axis)
        slopes = np.zeros_like(self.mean)
        by_angle = scale * (aside @ axis)
        slopes[rows, whose], slopes[rows, whose + 1], slopes[:, TRAVEL] = by_angle, -travel * by_angle, -rate * by_angle
        slopes[:, CAMERA_LATE] = np.where(self._other > 0, 0.0, rate * by_angle)
        slopes[:, BIAS], slopes[:, DELAY], slopes[:, SPACING] = 1.0, 1.0, along
        expected = along + self.mean[:, DELAY] + self.mean[:, BIAS]
        left = event.cosines[None, :] - expected[:, None]
        counts = np.where(self._other > 0, self._other_known, True)
        # A window is heard as its loudest part, which may be any: the direction moves while it lasts.
        moved = by_angle * (rate - self._turn * event.yaw_rate) * event.window
        self._update(left, slopes, event.variance + moved**2 / 12.0, SOUND_CLUTTER, 0.5, counts)
        self._other_known = True

    def _adapt(self, left: NDArray, slopes: NDArray, variance: NDArray) -> None:
        """Let the target manoeuvre as much as the best hypothesis needs, for all of them: its normalised squares become 1.

        A rig that follows a target turns as the target moves; what a calm target would make unlikely is then no fault.

        Parameters:
            left, slopes, variance: as for `_update`, of one candidate.
        """
        best = int(np.argmax(self.evidence))
        spread = float(slopes[best] @ self.covariance[best] @ slopes[best] + variance[best])
        excess = min(float(left[best]) ** 2 / spread, LARGEST_SQUARE) - 1.0
        self._manoeuvre = min(max(self._manoeuvre * math.exp(ADAPTATION * excess), 1.0), MOST_MANOEUVRE)

    def fade(self, share: float) -> None:
        """Keep this share of the evidence against the prior, so that a mended set-up is believed again."""
        prior = np.log([h.prior for h in self.hypotheses])
        self.evidence = prior + share * (self.evidence - self.evidence.max() - prior + prior.max())

    def apart(self, number: int) -> float:
        """How far (rad) bearings by a hypothesis are from those of the description, the first hypothesis."""
        if SWAPPED in self.hypotheses[number].signs:
            return 0.5 * math.pi
        target = self.mean[number, TARGET] - self.mean[0, TARGET]
        return max(abs(math.remainder(target, math.tau)), abs(float(self.mean[number, CAMERA_YAW])))

    def posterior(self) -> NDArray:
        """Probabilities (h) of the hypotheses."""
        weights = np.exp(self.evidence - self.evidence.max())
        return np.asarray(weights / weights.sum())

    def _seen(self, event: SightEvent, focal: NDArray) -> tuple[NDArray, NDArray]:
        """Azimuth and elevation (h) of a sighting in the level body, by each hypothesis."""
        scale = np.exp(focal)
        ray = np.stack([np.full_like(scale, event.ray[0]), self._mirror * scale * event.ray[1], scale * event.ray[2]], axis=1)
        body = ray @ event.view.T
        turn = self.mean[:, CAMERA_YAW]
        body = np.stack([np.cos(turn) * body[:, 0] - np.sin(turn) * body[:, 1],
                         np.sin(turn) * body[:, 0] + np.cos(turn) * body[:, 1], body[:, 2]], axis=1)
        level = body @ event.level.T
        return np.arctan2(level[:, 1], level[:, 0]), np.arctan2(level[:, 2], np.hypot(level[:, 0], level[:, 1]))

    def _update(self, left: NDArray, slopes: NDArray, variance: NDArray, clutter: float, uniform: float,
                counts: NDArray | bool, scale: NDArray | float = 1.0) -> NDArray:
        """Use one scalar measurement with several candidates; the probability (h) that one of them is the target's.

        Parameters:
            left: (h, n) measured minus expected.
            slopes: (h, SIZE) derivatives of what is expected.
            variance: (h) of the measurement.
            clutter, uniform: probability that it is clutter, and density of clutter.
            counts: (h) or one; whether it is evidence. The first of a target only tells where it is, and is as likely anywhere.
            scale: (h) derivative of `left` by what was measured.
        """
        gain = np.einsum('hij,hj->hi', self.covariance, slopes)
        spread = np.einsum('hi,hi->h', slopes, gain) + variance
        densities = np.exp(-0.5 * left**2 / spread[:, None]) / np.sqrt(math.tau * spread)[:, None]
        best = np.argmax(densities, axis=1)
        rows = np.arange(len(left))
        genuine = (1.0 - clutter) * scale * densities.mean(axis=1)
        likelihood = genuine + clutter * uniform
        self.evidence += np.where(counts, np.log(likelihood), math.log(uniform))
        share = np.where(counts, genuine / likelihood, 1.0)
        innovation = left[rows, best]
        k = gain / spread[:, None]
        self.mean += (share * innovation)[:, None] * k
        change = share * ((1.0 - share) * innovation**2 - spread)
        self.covariance += change[:, None, None] * k[:, :, None] * k[:, None, :]
        return np.asarray(share)
