"""Names what is wrong with the description of a rig, by what its sound and one camera say of one target."""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Callable, Sequence
from itertools import combinations
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap
from av_common.track import Track
from av_fusion.consistency.events import Fault, SightEvent, SoundEvent
from av_fusion.consistency.setup_model import (
    ALONE,
    CAMERA_LATE,
    CAMERA_YAW,
    DELAY,
    FOCAL,
    IMAGES,
    MIRRORED,
    REVERSED_YAW,
    ROLLED_LEFT,
    ROLLED_RIGHT,
    SPACING,
    SWAPPED,
    YAW_DELAYS_S,
    FilterBank,
    Hypothesis,
)
from av_fusion.disambiguation.ambiguity import RELEASE
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import direction, heading, turned_back


class Part(NamedTuple):
    """One thing that may be wrong.

    Parameters:
        text: what is said of it; with `{value}` for a parameter, and `{seer}` for the camera.
        mend: where it is mended; with `{camera}` for the camera's name.
        prior: probability before any measurement.
        sigma: prior standard deviation of a parameter.
        shown: from the parameter to the value that is said.
        for_pair: it concerns linear arrays only.
        is_mild: bearings are still right to some degrees.
    """

    text: str
    mend: str
    prior: float = 0.01
    sigma: float = 0.0
    shown: Callable[[float], float] = float
    for_pair: bool = False
    is_mild: bool = False


SIGNS = {
    SWAPPED: Part('the microphones are exchanged', 'exchange their channels, or their positions in the file of the array',
                  for_pair=True),
    MIRRORED: Part('the image of the {seer} is mirrored or upside down',
                   'the flip of the {seer}\'s driver, or a roll of 180 in {camera}: mount: rpy_deg'),
    ROLLED_LEFT: Part('the {seer} is rolled to the left by 90 deg', 'a roll of -90 in {camera}: mount: rpy_deg'),
    ROLLED_RIGHT: Part('the {seer} is rolled to the right by 90 deg', 'a roll of 90 in {camera}: mount: rpy_deg'),
    REVERSED_YAW: Part('the yaw of the odometry has the wrong sign',
                       'odometry in ENU: counter-clockwise is positive (REP-103)')}
PARAMETERS = {
    CAMERA_YAW: Part('the {seer} is turned by {value:+.0f} deg against its description, or the microphones by the opposite',
                     'mount: rpy_deg of {camera} or array in the rig', 0.05, math.radians(20.0),
                     lambda value: math.degrees(wrap(value))),
    CAMERA_LATE: Part('images are stamped {value:+.2f} s late by the {seer}', 'its driver, or sight_delay of fusion_node',
                      sigma=0.3),
    DELAY: Part('one channel is late: directions are off by {value:+.2f} in the cosine', 'the delay between the channels',
                0.015, 0.4, for_pair=True),
    SPACING: Part('the microphones are {value:.2f} times as far apart as described', 'positions in the file of the array',
                  sigma=0.4, shown=math.exp, for_pair=True, is_mild=True),
    FOCAL: Part('the focal length of the {seer} is {value:.2f} times that described',
                'horizontal_fov_deg or calibration_file of the {seer}',
                sigma=0.3, shown=lambda value: math.exp(-value), is_mild=True)}
# Priors are those of a rig that somebody has just put together; two wrong signs are independent of each other. Hypotheses of
# several parameters are too flexible: among many sources one of them explains everything.
DESCRIBED, TWO = 0.85, 1e-4
QUARTERS = math.radians(90.0), math.radians(-90.0), math.radians(180.0)  # by which frames of cameras are mistaken


def hypotheses(is_pair: bool) -> tuple[Hypothesis, ...]:
    """What may be wrong: nothing, which is the first, one thing, or two signs.

    Parameters:
        is_pair: whether the array is linear.
    """
    sigmas = {index: part.sigma for index, part in PARAMETERS.items() if is_pair or not part.for_pair}
    signs = [sign for sign, part in SIGNS.items() if is_pair or not part.for_pair]
    mounted = [((), turned) for turned in QUARTERS] + ([((SWAPPED,), 0.0)] if is_pair else [])
    return (Hypothesis(DESCRIBED),
            *(Hypothesis(SIGNS[sign].prior, (sign,)) for sign in signs),
            *(Hypothesis(PARAMETERS[index].prior, (), {index: sigma}) for index, sigma in sigmas.items()),
            *(Hypothesis(TWO, swapped, {CAMERA_YAW: sigmas[CAMERA_YAW]}, turned) for swapped, turned in mounted),
            *(Hypothesis(TWO, both) for both in combinations(signs, 2) if not set(both) <= set(IMAGES)))


# A description that holds is suspected, or called wrong, with these probabilities in each EVIDENCE_S: the likelihood ratio of
# the faults, by their priors, ever exceeds 1/a with probability a at most, however long one waits (Ville 1939, Wald 1945).
SUSPECTED, NAMED = 1e-3, 1e-4
LEAST_NAMED = 0.05  # likelihood against the best, of a fault that explains the measurements as well, and is named, too
LEAST_BELIEVED = 0.01  # below it a fault does not widen a bearing: of errors of 90 or 180 deg it would be all of the variance
LAG_S = 0.6  # measurements wait for those of before, and for the heading around their time
GAP_S = 1.5  # after which a sighting belongs to a new target
SIGHT_PERIOD_S, SIMULTANEOUS_S = 0.2, 0.5  # between two sightings; between sound and the sighting that it is compared with
EVIDENCE_S = 120.0  # time of observation in which evidence fades to 1/e
SIGHT_SIGMA, SOUND_SIGMA = math.radians(0.5), math.radians(1.5)  # beyond the reported errors
LEAST_SCORE = 0.5  # of a sighting, and of a sound's probability to be a drone
MOST_HEARD = 2  # directions of a window that is evidence: of the target, and of one other source or reflection
MOST_WAITING = 400  # measurements: some 6 s of three cameras at 15 Hz and of sound at 20 Hz, ten times LAG_S


class Belief(NamedTuple):
    """What is published of a target: the mixture of the hypotheses by their probabilities (Hoeting et al. 1999).

    Parameters:
        flipped: probability that the rig turns, or hears, the other way round: front and back are exchanged by sound.
        in_body, in_world (rad^2): mean square by which a bearing is off.
    """

    flipped: float = 0.0
    in_body: float = 0.0
    in_world: float = 0.0

    def of(self, track: Track) -> Track:
        """A track with the uncertainty of the set-up."""
        front = track.front_probability + self.flipped * (1.0 - 2.0 * track.front_probability)
        east, cross, _, up = track.covariance_world
        return track._replace(
            azimuth_variance=track.azimuth_variance + self.in_body, covariance_world=(east + self.in_world, cross, cross, up),
            front_probability=front, resolved=track.resolved and self.flipped <= 1.0 - RELEASE)


class CameraMonitor:
    """Weighs what may be wrong with the set-up by sound and one camera's sight of one target, and by the rig's motion.

    Each of the `hypotheses` predicts the measurements by one model of the set-up; their likelihoods multiply.

    Attributes:
        belief: what is published.
        seen (s): capture time of the newest image that was used.
        is_confirmed: whether sound and this camera agree so well that no fault is believed, of either.

    Parameters:
        motion: attitude of the rig.
        camera: name of the camera.
        sound_delay, sight_delay (s): delay of the stamps of directions of arrival and of images.
    """

    def __init__(self, motion: RigMotion, camera: str, sound_delay: float, sight_delay: float) -> None:
        self._camera, self._motion, self._sound_delay, self._sight_delay = camera, motion, sound_delay, sight_delay
        self._waiting: list[tuple[float, CameraMeasurement | tuple[DoaMeasurement, ...]]] = []
        self._bank: FilterBank | None = None
        self._time = self.seen = self._heard = self._several = -math.inf
        self._wrong: Fault | None = None
        self.belief, self.is_confirmed = Belief(), False
        self._sights = False  # whether anything was seen
        self._jumps = self._motion.jumps

    def add_doas(self, measurements: Sequence[DoaMeasurement]) -> None:
        """Take the directions of one window, those that may be a drone's."""
        usable = tuple([one for one in measurements if not one.drone_probability < LEAST_SCORE])
        if usable:
            if self._bank is None:
                self._begin(usable[0].cone is not None)
            self._add(usable[0].time - self._sound_delay, usable)

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """Take an image in which something is seen."""
        if measurement.best is not None and measurement.best.score >= LEAST_SCORE:
            self._sights = True
            self._add(measurement.time - self._sight_delay, measurement)

    def _add(self, time: float, measurement: CameraMeasurement | tuple[DoaMeasurement, ...]) -> None:
        insort(self._waiting, (time, measurement), key=itemgetter(0))
        del self._waiting[:-MOST_WAITING]

    def advance(self, now: float) -> Fault | None:
        """Use what is older than LAG_S at `now` (s); returns what is known to be wrong, until the description fits again."""
        while self._waiting and self._waiting[-1][0] > now + GAP_S:  # of a clock that was set back
            self._waiting.pop()
        if self._bank is not None:
            self._weigh(self._bank, now)
        return self._wrong

    def _weigh(self, bank: FilterBank, now: float) -> None:
        """Weigh the hypotheses by what is older than LAG_S."""
        if now < self._time - GAP_S or self._motion.jumps != self._jumps:  # a clock or heading was set: the set-up is the same
            self._jumps = self._motion.jumps
            self._time = self.seen = self._heard = self._several = -math.inf
            self._waiting.clear()
            bank.turn_world()
        while self._waiting and self._waiting[0][0] <= now - LAG_S:
            time, measurement = self._waiting.pop(0)
            if time >= self._time and self._motion.is_known(time):
                if isinstance(measurement, CameraMeasurement):
                    self._see(bank, time, measurement)
                else:
                    self._hear(bank, time, measurement)
        posterior = bank.posterior()
        self._decide(bank, posterior)
        self.is_confirmed = bool(posterior[1:].max() < LEAST_BELIEVED)
        if self._sights:
            self.belief = self._believe(bank, posterior, now)

    def _begin(self, is_pair: bool) -> None:
        bank = self._bank = FilterBank(hypotheses(is_pair))
        self._odds = sum(one.prior for one in bank.hypotheses[1:]) / bank.hypotheses[0].prior
        self._flips = np.array([is_pair and len({SWAPPED, REVERSED_YAW}.intersection(h.signs)) == 1
                                for h in bank.hypotheses])
        self._apart = np.tile([h.sigmas.get(CAMERA_YAW, 0.0) ** 2 + h.turned**2 for h in bank.hypotheses], (2, 1))

    def _see(self, bank: FilterBank, time: float, measurement: CameraMeasurement) -> None:
        if time < self.seen + SIGHT_PERIOD_S:
            return
        if time > self.seen + GAP_S:
            bank.forget_target()
        self._pass(bank, time)
        found = sorted((one for one in measurement.detections if one.score >= LEAST_SCORE), key=lambda one: -one.score)
        if len(found) > 1:
            self._several = time
        rays = np.array([turned_back(measurement.view, direction(one.azimuth, one.elevation)) for one in found])
        yaws = np.unwrap([self._motion.yaw(time - delay) for delay in YAW_DELAYS_S])
        event = SightEvent(rays, np.array(measurement.view), self._level(time), yaws,
                           found[0].across_variance + SIGHT_SIGMA**2, measurement.half_view)
        bank.see(event, time > self._several + GAP_S)  # of several things it is not known which is the other sensor's
        self.seen = time

    def _hear(self, bank: FilterBank, time: float, window: tuple[DoaMeasurement, ...]) -> None:
        first, cone = window[0], window[0].cone
        if time < self._heard + first.window:  # windows that overlap are repetitions
            return
        self._pass(bank, time)
        self._heard = time
        is_seen = abs(time - self.seen) <= SIMULTANEOUS_S and len(window) <= MOST_HEARD
        pose = (self._level(time), self._motion.yaw(time))
        images = np.array([h.azimuth for h in first.hypotheses])
        if cone is not None:
            cosines = np.array([m.cone.cosine for m in window if m.cone is not None])
            variance = cone.variance + SOUND_SIGMA**2 * cone.slope_squared
            bank.hear(SoundEvent(np.array([cone.axis]), cosines[:, None], np.array([[variance]]), images, math.nan, *pose),
                      is_seen)
            return
        one = first.hypotheses[0]
        axes = np.array([direction(one.azimuth + 0.5 * math.pi), direction(one.azimuth)])
        heard = np.array([direction(m.hypotheses[0].azimuth, m.hypotheses[0].elevation) for m in window])
        across, up, level = one.across_variance, min(one.elevation_variance, 1.0), math.cos(one.elevation) ** 2
        covariance = np.diag([across, (1.0 - level) * up + 0.5 * level * up**2]) + SOUND_SIGMA**2 * np.eye(2)
        climb = min(max((pose[0] @ heard[0])[2], -1.0), 1.0)  # rounding exceeds 1 at the zenith
        bank.hear(SoundEvent(axes, heard @ axes.T, covariance, images, math.asin(climb), *pose), is_seen)

    def _pass(self, bank: FilterBank, time: float) -> None:
        seconds = min(time - self._time, GAP_S) if math.isfinite(self._time) else 0.0
        bank.predict(seconds)
        bank.fade(math.exp(-seconds / EVIDENCE_S))
        self._time = time

    def _level(self, time: float) -> NDArray:
        """Rotation of the body against a level one of the same heading."""
        return np.asarray(np.array(heading(self._motion.yaw(time))).T @ np.array(self._motion.attitude(time)))

    def _decide(self, bank: FilterBank, posterior: NDArray) -> None:
        faults = np.argsort(-posterior[1:]) + 1
        wrong = max(float(np.add.reduce(posterior[1:])), 1e-300)
        chance = self._odds * float(posterior[0]) / wrong  # bound of the probability of such a ratio, where nothing is wrong
        if chance < SUSPECTED:
            likelihood = posterior / [h.prior for h in bank.hypotheses]
            named = [k for k in faults if likelihood[k] >= min(LEAST_NAMED * likelihood[1:].max(), likelihood[faults[0]])]
            self._wrong = self._fault_of(bank, named, wrong, chance < NAMED)
        elif chance > 1.0:
            self._wrong = None

    def _believe(self, bank: FilterBank, posterior: NDArray, now: float) -> Belief:
        """What is published of a bearing at `now` (s): while nothing is seen, bearings are off by as much as when it was."""
        if bank.target_known and now - self.seen <= GAP_S:
            self._apart = bank.apart(now - self._time, self._motion.yaw(now))
        believed = np.where(posterior < LEAST_BELIEVED, 0.0, posterior)
        return Belief(*map(float, np.vstack([self._flips, self._apart]) @ believed))

    def _fault_of(self, bank: FilterBank, named: Sequence[int], probability: float, is_sure: bool) -> Fault:
        """A fault by the indices of its hypotheses, the most probable first."""
        parts = _parts(bank.hypotheses[named[0]])
        certain = not all(part.is_mild for part in parts) and (is_sure or (self._wrong is not None and self._wrong.is_certain))
        kinds = [frozenset(_parts(bank.hypotheses[number])) for number in named]  # of which none has all parts of another one
        told = [number for k, number in enumerate(named) if not any(kind <= kinds[k] for kind in kinds[:k])]
        texts, mends = zip(*[self._words(bank, number) for number in told], strict=True)
        return Fault('; or '.join(texts), '; or '.join(mends), probability, certain)

    def _words(self, bank: FilterBank, number: int) -> tuple[str, str]:
        """What a hypothesis says, with the value of its parameter, and where that is mended."""
        hypothesis, seer = bank.hypotheses[number], self._camera.replace('_', ' ')
        value = sum(PARAMETERS[index].shown(float(bank.mean[ALONE + number, index])) for index in hypothesis.sigmas)    # one
        text, mend = (', and '.join(words) for words in zip(*[(part.text, part.mend) for part in _parts(hypothesis)],
                                                            strict=True))
        return text.format(value=value, seer=seer), mend.format(camera=self._camera, seer=seer)


def _parts(hypothesis: Hypothesis) -> list[Part]:
    """What is wrong by a hypothesis."""
    return [*(SIGNS[sign] for sign in hypothesis.signs), *(PARAMETERS[index] for index in hypothesis.sigmas)]
