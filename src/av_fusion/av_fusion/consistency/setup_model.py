"""One model of a rig's set-up: what sound and sight of one target measure, by what may be wrong with their description.

The state of a hypothesis holds the target's motion and the parameters of the set-up. A hypothesis differs from another by its
prior of these parameters (how far each may be off) and by three signs. Whether sound stems from what is seen is a state of
each hypothesis; where it does not, all of them predict it by one and the same model, so that it is evidence for none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap
from av_fusion.consistency.events import SightEvent, SoundEvent

TARGET, TARGET_RATE, BIAS, RADIAL_BIAS, CAMERA_YAW, CAMERA_LATE, DELAY, SPACING, FOCAL = range(9)
SIZE = 9  # of the state: the above
ALONE = 4  # first filters of the bank: sound by itself, by both mirror images of where it was first heard, moving or at rest
# Errors that a careful description still has: of the camera's yaw (rad), its stamps (s), the delay between the microphones as
# a cosine, and the logarithms of spacing and focal length. Self-calibration learns what remains.
CAREFUL = {CAMERA_YAW: math.radians(2.0), CAMERA_LATE: 0.03, DELAY: 0.02, SPACING: 0.04, FOCAL: 0.1}
TRAVEL_S = 0.1  # time that sound takes, over a distance of 34 m
# Directions of arrival err together for some time, by reflections and by the housing: an Ornstein-Uhlenbeck process.
BIAS_SIGMA, BIAS_TIME_S = 0.05, 2.0  # of a cosine
# Multirotors accelerate by 3 to 6 m/s^2: 8 deg/s^2 at 30 m, for about a second (Singer 1970, whose density is 2 sigma^2 tau).
ACCELERATION_DENSITY = 2.0 * math.radians(8.0) ** 2 * 1.0  # rad^2/s^3
REST = 0.003  # of this density, of a source at rest
RATE_SIGMA = math.radians(15.0)  # rad/s, of a target that was just found
YAW_DELAYS_S = np.arange(-0.4, 1.05, 0.2)  # at which the heading is looked up for cameras whose stamps are wrong
SIGHT_CLUTTER, SOUND_CLUTTER = 0.05, 0.1  # probability that a measurement stems from nothing of what is modelled
UNIFORM = {1: 0.5, 2: 1.0 / math.pi}  # density of a cosine, or of a projection on a plane, that may be any
# A detection and a sound may be of two things: one in twenty; they become so, or one thing again, after these times.
UNPAIRED, PARTS_S, MEETS_S = 0.05, 60.0, 10.0

SWAPPED, REVERSED_YAW = 'swapped', 'reversed yaw'  # signs that may be wrong
MIRRORED, ROLLED_LEFT, ROLLED_RIGHT = 'mirrored', 'rolled left', 'rolled right'
# From rays as the image shows them to those in the camera, where it is not as described.
IMAGES = {MIRRORED: np.diag([1.0, -1.0, 1.0]), ROLLED_LEFT: np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
          ROLLED_RIGHT: np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])}


@dataclass(frozen=True)
class Hypothesis:
    """What may be wrong with the description of a rig.

    Parameters:
        prior: probability before any measurement.
        signs: which are wrong: the order of channels, the yaw of odometry, one of IMAGES.
        sigmas: prior standard deviations of the parameters that are off, by their index.
        turned (rad): prior mean of the camera's yaw.
    """

    prior: float
    signs: tuple[str, ...] = ()
    sigmas: Mapping[int, float] = field(default_factory=dict)
    turned: float = 0.0


class FilterBank:
    """An extended Kalman filter for each hypothesis, and the logarithm of its evidence (Magill 1965).

    A measurement may be clutter: it enters with the probability that it is none (Bar-Shalom, probabilistic data association).
    Sound stems from the target, from another thing that is seen, or from something else; which of these is a Markov chain of
    each hypothesis (Rabiner 1989).

    The target's angle is that at the capture of what the camera has just sent, CAMERA_LATE before its stamp.

    Attributes:
        mean: (ALONE + h, SIZE); covariance: (ALONE + h, SIZE, SIZE).
        evidence: (h) logarithms.
        paired: (2, h) probabilities that sound stems from the target, and from another thing that is seen.
        target_known: whether the target was seen, and is no outlier by the description.

    Parameters:
        hypotheses: h hypotheses.
    """

    def __init__(self, hypotheses: tuple[Hypothesis, ...]) -> None:
        number, self.hypotheses = ALONE + len(hypotheses), hypotheses
        self.mean, self.covariance = np.zeros((number, SIZE)), np.zeros((number, SIZE, SIZE))
        self._prior = np.log([h.prior for h in hypotheses])
        self.evidence = self._prior.copy()
        for index, sigma in CAREFUL.items():
            self.covariance[:, index, index] = [sigma**2] * ALONE + [h.sigmas.get(index, sigma) ** 2 for h in hypotheses]
        self.covariance[:, BIAS, BIAS] = self.covariance[:, RADIAL_BIAS, RADIAL_BIAS] = BIAS_SIGMA**2
        self.mean[ALONE:, CAMERA_YAW] = [h.turned for h in hypotheses]
        self._channel, self._turn = (np.array([1.0] * ALONE + [-1.0 if sign in h.signs else 1.0 for h in hypotheses])
                                     for sign in (SWAPPED, REVERSED_YAW))
        self._image = np.stack([np.eye(3)] * ALONE + [next((IMAGES[sign] for sign in h.signs if sign in IMAGES), np.eye(3))
                                                      for h in hypotheses])
        self._rolled = self._image[ALONE:, 1, 1] == 0.0
        self._sees = np.arange(number) >= ALONE
        self._described = 0.0
        self._beside = self._elevations = np.zeros((1, number))  # (rad) of all that is seen, the target first
        self._set_up_slopes = np.zeros((len(hypotheses), SIZE))
        self._shares = np.array([[1.0], [0.0]])  # of the target and of the others among what is seen
        self._sides = np.full(ALONE, 1.0 / ALONE)  # probabilities of these filters
        self._unpaired = np.array([np.full(len(hypotheses), one) for one in (1.0, 1.0 / UNPAIRED)])  # and all targets
        self._apart: NDArray | None = None  # probabilities that sound is not of what is seen, when it was last compared
        self.turn_world()

    def forget_target(self) -> None:
        """A new target begins; what is known of the set-up stays."""
        self._forget(self._sees)
        if self._apart is not None:
            self._unpaired += [self._apart, np.ones_like(self._apart)]
            self._apart = None
        self.paired = np.zeros((2, len(self.hypotheses)))
        self.target_known = False

    def turn_world(self) -> None:
        """The heading was corrected: nothing is known of where things are, but of the set-up."""
        self.forget_target()
        self._forget(~self._sees)
        self._sound_known = False

    def _forget(self, rows: NDArray) -> None:
        """Forget where the target of some filters is, and its rate."""
        for index, sigma in ((TARGET, math.pi), (TARGET_RATE, RATE_SIGMA)):
            self.covariance[rows, index, :] = 0.0
            self.covariance[rows, :, index] = 0.0
            self.covariance[rows, index, index] = sigma**2
        self.mean[rows, TARGET_RATE] = 0.0

    def predict(self, seconds: float) -> None:
        """Let time pass (s)."""
        step = np.eye(SIZE)
        step[TARGET, TARGET_RATE] = seconds
        kept = step[BIAS, BIAS] = step[RADIAL_BIAS, RADIAL_BIAS] = math.exp(-seconds / BIAS_TIME_S)
        self._described += seconds * self.mean[ALONE, TARGET_RATE]
        self.mean = self.mean @ step.T
        self.covariance = step @ self.covariance @ step.T
        self.covariance[:, (BIAS, RADIAL_BIAS), (BIAS, RADIAL_BIAS)] += BIAS_SIGMA**2 * (1.0 - kept**2)
        growth = ACCELERATION_DENSITY * np.array([[seconds**3 / 3.0, seconds**2 / 2.0], [seconds**2 / 2.0, seconds]])
        # How much a target manoeuvres, as seen, is no evidence for a scale of angles: its distance is not known.
        scale = np.exp(2.0 * self.mean[:, FOCAL])
        scale[:ALONE] = 1.0, 1.0, REST, REST
        self.covariance[:, :TARGET_RATE + 1, :TARGET_RATE + 1] += scale[:, None, None] * growth
        stays, meets = math.exp(-seconds / PARTS_S), 1.0 - math.exp(-seconds / MEETS_S)
        self.paired = self.paired * stays + (1.0 - self.paired.sum(axis=0)) * meets * self._shares

    def see(self, event: SightEvent, counts: bool = True) -> None:
        """Use an image, in which one detection at most is the target.

        Parameters:
            event: the image.
            counts: whether it is evidence; what is none says nothing of the set-up.
        """
        self._shares = np.array([[1.0], [len(event.rays) - 1.0]]) / len(event.rays)
        late = self.mean[:, CAMERA_LATE]
        yaws = self._turn * np.interp(late, YAW_DELAYS_S, event.yaws)
        turning = self._turn * np.interp(late, YAW_DELAYS_S, np.gradient(event.yaws, YAW_DELAYS_S))
        azimuths, elevations = self._seen(event.rays, event, self.mean[:, FOCAL])
        if not self.target_known:
            self.mean[self._sees, TARGET] = (azimuths[:, 0] + yaws)[self._sees]
        every = wrap(azimuths - (self.mean[:, TARGET] - yaws)[:, None])
        rows, nearest = np.arange(len(every)), np.argmin(np.abs(every), axis=1)
        left = every[rows, nearest]
        moved, _ = self._seen(event.rays, event, self.mean[:, FOCAL] + 0.01)
        slopes = np.zeros_like(self.mean)
        slopes[:, TARGET], slopes[:, CAMERA_YAW], slopes[:, CAMERA_LATE] = 1.0, -1.0, -turning
        slopes[:, FOCAL] = -wrap(moved - azimuths)[rows, nearest] / 0.01
        scale = np.exp(self.mean[:, FOCAL])    # of angles: the density is that of the angle as it was measured
        variance = event.variance * scale**2
        densities, gain, spread = self._compare(every[:, :, None], slopes[:, None], variance[:, None, None])
        genuine = self._sees * (1.0 - SIGHT_CLUTTER) * scale * densities.mean(axis=1)
        likelihood = genuine + SIGHT_CLUTTER * 0.5 / event.half_view
        share = genuine / likelihood
        if self.target_known:
            # Of a rolled camera azimuths are the image's other coordinate, whose likelihood compares with nothing.
            self.evidence += counts * np.log(np.where(self._rolled, likelihood[ALONE], likelihood[ALONE:]))
        else:  # the first of a target only tells where it is, and is as likely anywhere
            share = self._sees * 1.0
            self.paired = (1.0 - self._unpaired[0] / self._unpaired[1]) * self._shares
        self._correct(left[:, None], gain, spread, share, SIZE if counts else BIAS)
        self.target_known = True
        if share[ALONE] < 0.5:  # by the description it is not the target of before, once: what follows is no more evidence
            self.forget_target()
            return
        order = np.argsort(np.abs(every), axis=1)
        azimuths, self._elevations = (np.take_along_axis(angle, order, axis=1).T for angle in (azimuths, elevations))
        self._beside = wrap(azimuths - azimuths[0]) * self._sees
        x, y, _ = event.level @ event.view @ event.rays[nearest[ALONE]]
        self._set_up_slopes = slopes[ALONE:] * (np.arange(SIZE) != TARGET)  # of where the camera saw it, by the set-up alone
        self._described = math.atan2(y, x) + float(np.interp(0.0, YAW_DELAYS_S, event.yaws))

    def hear(self, event: SoundEvent, is_seen: bool) -> None:
        """Use a window of sound.

        Parameters:
            event: the window, in which one direction at most is of what is seen.
            is_seen: whether anything is seen now.
        """
        if not self._sound_known:
            self.mean[:ALONE, TARGET] = event.images[[0, -1, 0, -1]] + event.yaw
        compared = [self._hear_of(event, *thing) for thing in zip(self._beside, self._elevations, strict=True)]
        left, densities, gain, spread = (np.stack(parts, axis=1) for parts in zip(*compared, strict=True))
        genuine = (1.0 - SOUND_CLUTTER) * densities.mean(axis=2)
        weights = self._weights(is_seen)
        unknown = UNIFORM[len(event.axes)]
        likelihood = weights * (genuine + SOUND_CLUTTER * unknown)
        share = np.sum(weights * genuine, axis=1) / np.maximum(np.sum(likelihood, axis=1), 1e-300)
        if self._sound_known:
            alone = float(self._sides @ likelihood[:ALONE, 0])
            self._sides = 0.98 * self._sides * likelihood[:ALONE, 0] / alone + 0.02 / ALONE
        else:
            alone, share[:ALONE] = unknown, 1.0
        self._sound_known = True
        if weights[ALONE:].any():
            total = np.sum(likelihood[ALONE:], axis=1) + (1.0 - np.sum(weights[ALONE:], axis=1)) * alone
            self.evidence += np.log(total)
            self.paired = np.stack([likelihood[ALONE:, 0], np.sum(likelihood[ALONE:, 1:], axis=1)]) / total
            self._apart = 1.0 - np.sum(self.paired, axis=0)
        rows, most = np.arange(len(left)), np.argmax(weights * genuine, axis=1)
        left = left[rows, most]
        nearest = np.argmin(np.sum(left**2, axis=2), axis=1)
        self._correct(left[rows, nearest], gain[rows, most], spread[rows, most], share)
        if share[:ALONE].max() < 0.5:  # another source
            self._forget(~self._sees)
            self._sound_known = False

    def _weights(self, is_seen: bool) -> NDArray:
        """Probabilities (ALONE + h, t) that sound is of each thing that is seen; the filters of sound alone have one thing."""
        weights = np.zeros(self._beside.T.shape)
        weights[:ALONE, 0] = 1.0
        if is_seen and self.target_known:
            weights[ALONE:, 0] = self.paired[0]
            weights[ALONE:, 1:] = self.paired[1][:, None] / max(len(self._beside) - 1, 1)
        return weights

    def _hear_of(self, event: SoundEvent, beside: NDArray, elevation: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """A window as sound of one thing that is seen: measured minus expected (ALONE + h, n, d), and of `_compare`.

        Parameters:
            event: the window.
            beside, elevation (rad): (ALONE + h) of the thing, the azimuth off the target's.
        """
        rate = self.mean[:, TARGET_RATE]
        travel = TRAVEL_S - self._sees * self.mean[:, CAMERA_LATE]
        across = self.mean[:, TARGET] + beside - rate * travel - self._turn * event.yaw
        if len(event.axes) > 1:  # sound alone
            elevation = np.where(self._sees, elevation, event.elevation)
        level = np.cos(elevation)
        flat = np.stack([level * np.cos(across), level * np.sin(across), np.sin(elevation)], axis=1)
        aside = np.stack([-flat[:, 1], flat[:, 0], np.zeros_like(level)], axis=1)
        axes = event.level @ event.axes.T
        spacing = np.exp(self.mean[:, SPACING])
        along = (self._channel * spacing)[:, None] * (flat @ axes)
        # Errors are often smaller than reported. To expect less of them, as by a smaller array, is no evidence for a fault.
        by_angle = (self._channel * np.maximum(spacing, 1.0))[:, None] * (aside @ axes)
        slopes = np.zeros((*by_angle.shape, SIZE))
        for index, factor in ((TARGET, 1.0), (TARGET_RATE, -travel), (CAMERA_LATE, self._sees * rate)):
            slopes[:, :, index] = np.reshape(factor, (-1, 1)) * by_angle
        slopes[:, :, SPACING] = along
        offsets = [[BIAS, DELAY]] if len(event.axes) == 1 else [[BIAS], [RADIAL_BIAS]]
        for row, indices in enumerate(offsets):
            slopes[:, row, indices] = 1.0
        left = event.measured - (along + np.stack([self.mean[:, one].sum(axis=1) for one in offsets], axis=1))[:, None]
        variance = np.tile(event.covariance, (len(left), 1, 1))
        variance[:ALONE, 1:, 1:] += event.covariance[1:, 1:]
        return left, *self._compare(left, slopes, variance)

    def apart(self, seconds: float, yaw: float) -> NDArray:
        """Mean squares (2, h; rad^2) by which the target is off where it was seen by the description, in body and world.

        The error of a careful description is no part of them.

        Parameters:
            seconds (s): since the newest measurement.
            yaw (rad): heading then.
        """
        mean = self.mean[ALONE:]
        rate, ahead = mean[:, TARGET_RATE], seconds + mean[:, CAMERA_LATE]
        slopes = self._set_up_slopes.copy()
        slopes[:, CAMERA_LATE] -= rate
        variance = np.einsum('hi,hij,hj->h', slopes, self.covariance[ALONE:], slopes)
        in_world = wrap(mean[:, TARGET] + rate * ahead - (self._described + rate[0] * seconds))
        in_body = wrap(in_world - (self._turn[ALONE:] - 1.0) * yaw)
        spread = np.maximum(variance - variance[0], 0.0)
        return np.asarray(np.maximum(np.square([in_body, in_world]) + spread - CAREFUL[CAMERA_YAW] ** 2, 0.0))

    def fade(self, share: float) -> None:
        """Keep this share of the evidence against the prior, so that a mended set-up is believed again."""
        self.evidence = self._prior + share * (self.evidence - self.evidence.max() - self._prior + self._prior.max())

    def posterior(self) -> NDArray:
        """Probabilities (h) of the hypotheses."""
        weights = np.exp(self.evidence - np.maximum.reduce(self.evidence))
        return np.asarray(weights / np.add.reduce(weights))

    def _seen(self, rays: NDArray, event: SightEvent, focal: NDArray) -> tuple[NDArray, NDArray]:
        """Azimuths and elevations (ALONE + h, n) of rays (n, 3) in the level body, by each hypothesis."""
        turn, seen = self.mean[:, CAMERA_YAW], rays @ np.swapaxes(self._image, 1, 2)
        seen[..., 1:] *= np.exp(focal)[:, None, None]
        seen = seen @ event.view.T
        cosine, sine = np.cos(turn)[:, None], np.sin(turn)[:, None]
        x, y, z = seen[..., 0], seen[..., 1], seen[..., 2]
        x, y, z = np.moveaxis(np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=2) @ event.level.T, 2, 0)
        return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))

    def _compare(self, left: NDArray, slopes: NDArray, variance: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Densities (ALONE + h, n) of one measurement with n candidates; its covariance with the states and its own.

        Parameters:
            left: (ALONE + h, n, d) measured minus expected.
            slopes: (ALONE + h, d, SIZE) derivatives of what is expected.
            variance: (ALONE + h, d, d) of the measurement.
        """
        shared = self.covariance @ np.swapaxes(slopes, 1, 2)
        spread = slopes @ shared + variance
        squares = np.sum(left @ np.linalg.inv(spread) * left, axis=2)
        return np.exp(-0.5 * squares) / np.sqrt(np.linalg.det(math.tau * spread))[:, None], shared, spread

    def _correct(self, left: NDArray, shared: NDArray, spread: NDArray, share: NDArray, size: int = SIZE) -> None:
        """Use a measurement with the probability (ALONE + h) that it is the target's; the rest as of `_compare`.

        Of what is no evidence nothing is learned but the first `size` states; the others keep their uncertainty (Schmidt 1966).
        """
        k = shared @ np.linalg.inv(spread)
        k[:, size:] = 0.0
        share = share[:, None, None]
        self.mean += (share * k @ left[:, :, None])[:, :, 0]
        cross = share * k @ np.swapaxes(shared, 1, 2)
        more = share * ((1.0 - share) * left[:, :, None] * left[:, None, :] + spread)
        half = 0.5 * (self.covariance + k @ more @ np.swapaxes(k, 1, 2)) - cross
        self.covariance = half + np.swapaxes(half, 1, 2)  # symmetric in spite of rounding
