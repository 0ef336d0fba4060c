"""Names what is wrong with the description of a rig, by what its sensors say of one target."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from heapq import heappop, heappush
from itertools import combinations, count
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_fusion.consistency.setup_model import (
    CAMERA_LATE,
    CAMERA_YAW,
    DELAY,
    FOCAL,
    MIRRORED,
    REVERSED_YAW,
    SPACING,
    SWAPPED,
    YAW_DELAYS_S,
    FilterBank,
    Hypothesis,
    SightEvent,
    SoundEvent,
)
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement, usable_camera, usable_doa
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import direction, turned_back


class Part(NamedTuple):
    """One thing that may be wrong.

    Parameters:
        text: what is said of it; with `{value}` for a parameter.
        mend: where it is mended.
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
    MIRRORED: Part('the image is mirrored or upside down',
                   'the camera driver\'s flip, or a roll of 180 in camera: mount: rpy_deg'),
    REVERSED_YAW: Part('the yaw of the odometry has the wrong sign',
                       'odometry in ENU: counter-clockwise is positive (REP-103)')}
PARAMETERS = {
    CAMERA_YAW: Part('the camera is turned by {value:+.0f} deg against its description, or the microphones by the opposite',
                     'mount: rpy_deg of camera or array in the rig', sigma=math.radians(20.0), shown=math.degrees),
    CAMERA_LATE: Part('images are stamped {value:+.2f} s late', 'sight_delay of fusion_node', sigma=0.3),
    DELAY: Part('one channel is late: directions are off by {value:+.2f} in the cosine', 'the delay between the channels',
                0.003, 0.4, for_pair=True),
    SPACING: Part('the microphones are {value:.2f} times as far apart as described', 'positions in the file of the array',
                  sigma=0.4, shown=math.exp, for_pair=True, is_mild=True),
    FOCAL: Part('the focal length is {value:.2f} times that described', 'horizontal_fov_deg or calibration_file of the camera',
                sigma=0.3, shown=lambda value: math.exp(-value), is_mild=True)}
# Priors are those of a rig that somebody has just put together. Sound and sight of two different drones, each unheard or unseen
# by the other sensor, are little more frequent; two signs at once less so. Hypotheses of several parameters are too flexible:
# among many sources one of them explains everything (`faults --faultless birds_and_drones`).
DESCRIBED, OTHERS, TWO = 0.9, 0.02, 0.001


def hypotheses(is_pair: bool) -> tuple[Hypothesis, ...]:
    """What may be wrong: nothing, that both sensors have one source, one thing, or two signs.

    Parameters:
        is_pair: whether the array is linear.
    """
    signs = [sign for sign, part in SIGNS.items() if is_pair or not part.for_pair]
    sigmas = {index: part.sigma for index, part in PARAMETERS.items() if is_pair or not part.for_pair}
    return (Hypothesis(DESCRIBED), Hypothesis(OTHERS, other=1), Hypothesis(OTHERS, other=2),
            *(Hypothesis(SIGNS[sign].prior, (sign,)) for sign in signs),
            *(Hypothesis(PARAMETERS[index].prior, (), {index: sigma}) for index, sigma in sigmas.items()),
            *(Hypothesis(TWO, both) for both in combinations(signs, 2)))


SUSPECTED, NAMED = 0.99, 0.999  # probabilities of a fault for a warning, and for an error on which nothing moves (Wald 1945)
LEAST_NAMED = 0.05  # probability of a second fault that explains the measurements as well, and is named beside the first
LAG_S = 1.2  # measurements wait for those of before, and for the heading around their time
GAP_S = 1.5  # after which a sighting belongs to a new target
SIGHT_PERIOD_S, SIMULTANEOUS_S = 0.2, 0.5  # between two sightings; between sound and the sighting that it is compared with
EVIDENCE_S = 120.0  # time of observation in which evidence fades to 1/e
SIGHT_SIGMA, SOUND_SIGMA = math.radians(0.5), math.radians(1.5)  # beyond the reported errors
LEAST_SCORE = 0.5  # of a sighting, and of a sound's probability to be a drone
MOST_WAITING = 400


class Fault(NamedTuple):
    """What is wrong with the description of the rig.

    Parameters:
        text: what is wrong, with its value.
        mend: where it is mended.
        probability: that the description is wrong.
        is_certain: nothing should move by the bearing.
        apart (rad): how far bearings are off.
        concerns_world: only the direction in the world is wrong by it.
    """

    text: str
    mend: str
    probability: float
    is_certain: bool
    apart: float = 0.0
    concerns_world: bool = False

    def __str__(self) -> str:
        return f'{self.text} (probability {min(self.probability, 0.9999):.4f}): {self.mend}'


class ConsistencyMonitor:
    """Weighs what may be wrong with the set-up by sound and sight of one target, and by the rig's motion.

    Each of the `hypotheses` predicts the measurements by one model of the set-up; their likelihoods multiply. What no
    measurement of the rig can show is a heading that is off by a constant, and its drift while one target moves.

    Attributes:
        fault: what is known to be wrong, None without; it stays until the description fits again.

    Parameters:
        motion: attitude of the rig.
        sound_delay, sight_delay (s): delay of the stamps of directions of arrival and of images.
    """

    def __init__(self, motion: RigMotion, sound_delay: float = 0.0, sight_delay: float = 0.0) -> None:
        self._motion, self._sound_delay, self._sight_delay = motion, sound_delay, sight_delay
        self._waiting: list[tuple[float, int, CameraMeasurement | tuple[DoaMeasurement, ...]]] = []
        self._numbers = count()  # of measurements: those of one time stay in their order
        self._bank: FilterBank | None = None
        self._time = self._seen = self._heard = -math.inf
        self.fault: Fault | None = None
        self._jumps = self._motion.jumps

    def add_doas(self, measurements: Sequence[DoaMeasurement]) -> None:
        """Take the directions of one window, those that may be a drone's."""
        usable = tuple(m for m in map(usable_doa, measurements) if m is not None and not m.drone_probability < LEAST_SCORE)
        if usable:
            self._add(usable[0].time - self._sound_delay, usable)

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """Take an image in which something is seen."""
        usable = usable_camera(measurement)
        if usable is not None and usable.best is not None and usable.best.score >= LEAST_SCORE:
            self._add(usable.time - self._sight_delay, usable)

    def _add(self, time: float, measurement: CameraMeasurement | tuple[DoaMeasurement, ...]) -> None:
        if len(self._waiting) < MOST_WAITING:
            heappush(self._waiting, (time, next(self._numbers), measurement))

    def advance(self, now: float) -> Fault | None:
        """Use what is older than LAG_S at `now` (s); returns the fault that is known."""
        if now < self._time - GAP_S:  # the clock was set back: the set-up is the same
            self._time = self._seen = self._heard = -math.inf
            self._waiting.clear()
            if self._bank is not None:
                self._bank.turn_world()
        if self._motion.jumps != self._jumps:
            self._jumps, self._seen = self._motion.jumps, -math.inf
            if self._bank is not None:
                self._bank.turn_world()
        used = False
        while self._waiting and self._waiting[0][0] <= now - LAG_S:
            time, _, measurement = heappop(self._waiting)
            used = True
            if time >= self._time and self._motion.is_known(time):
                if isinstance(measurement, CameraMeasurement):
                    self._see(time, measurement)
                else:
                    self._hear(time, measurement)
        if used and self._bank is not None:
            self._decide(self._bank)
        return self.fault

    def _see(self, time: float, measurement: CameraMeasurement) -> None:
        best = measurement.best
        if best is None or time < self._seen + SIGHT_PERIOD_S:
            return
        if self._bank is not None:
            if time > self._seen + GAP_S:
                self._bank.forget_target()
            self._pass(self._bank, time)
            ray = turned_back(measurement.view, direction(best.azimuth, best.elevation))
            yaws = np.unwrap([self._motion.yaw(time - delay) for delay in YAW_DELAYS_S])
            self._bank.see(SightEvent(np.array(ray), np.array(measurement.view), self._level(time), yaws,
                                      best.across_variance + SIGHT_SIGMA**2, measurement.half_view))
        self._seen = time

    def _hear(self, time: float, window: tuple[DoaMeasurement, ...]) -> None:
        first, cone = window[0], window[0].cone
        if self._bank is None:
            self._bank = FilterBank(hypotheses(cone is not None))
        if time < self._heard + first.window or abs(time - self._seen) > SIMULTANEOUS_S:  # windows that overlap are repetitions
            return
        self._pass(self._bank, time)
        self._heard = time
        pose = (self._level(time), self._motion.yaw(time), self._motion.rate(time)[2], first.window)
        images = np.array([h.azimuth for h in first.hypotheses])
        if cone is not None:
            cosines = np.array([m.cone.cosine for m in window if m.cone is not None])
            variance = cone.variance + SOUND_SIGMA**2 * cone.slope_squared
            self._bank.hear(SoundEvent(np.array(cone.axis), cosines, variance, images, *pose))
            return
        across = first.hypotheses[0].across_variance + SOUND_SIGMA**2
        heard = np.array([direction(m.hypotheses[0].azimuth, m.hypotheses[0].elevation) for m in window])
        for axis in np.eye(3)[:2]:
            self._bank.hear(SoundEvent(axis, heard @ axis, across, images, *pose))

    def _pass(self, bank: FilterBank, time: float) -> None:
        seconds = min(time - self._time, GAP_S) if math.isfinite(self._time) else 0.0
        bank.predict(seconds)
        bank.fade(math.exp(-seconds / EVIDENCE_S))
        self._time = time

    def _level(self, time: float) -> NDArray:
        """Rotation of the body against a level one of the same heading."""
        yaw = self._motion.yaw(time)
        back = np.array([[math.cos(yaw), math.sin(yaw), 0.0], [-math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(back @ np.array(self._motion.attitude(time)))

    def _decide(self, bank: FilterBank) -> None:
        posterior = bank.posterior()
        faults = sorted((k for k, h in enumerate(bank.hypotheses) if h.is_fault), key=lambda k: -posterior[k])
        wrong = float(sum(posterior[k] for k in faults))
        if wrong >= SUSPECTED:
            named = [k for k in faults if k == faults[0] or posterior[k] > LEAST_NAMED]
            self.fault = self._fault_of(bank, named, wrong)
        elif wrong < 1.0 - SUSPECTED:
            self.fault = None

    def _fault_of(self, bank: FilterBank, named: Sequence[int], probability: float) -> Fault:
        """A fault by the indices of its hypotheses, the most probable first."""
        best = bank.hypotheses[named[0]]
        parts = _parts(best)
        certain = not all(part.is_mild for part in parts) and (
            probability >= NAMED or (self.fault is not None and self.fault.is_certain))
        texts = dict.fromkeys(_text(bank, number) for number in named)
        return Fault('; or '.join(texts), '; '.join(part.mend for part in parts), probability, certain, bank.apart(named[0]),
                     REVERSED_YAW in best.signs)


def _parts(hypothesis: Hypothesis) -> list[Part]:
    """What is wrong by a hypothesis."""
    return [*(SIGNS[sign] for sign in hypothesis.signs), *(PARAMETERS[index] for index in hypothesis.sigmas)]


def _text(bank: FilterBank, number: int) -> str:
    """What a hypothesis says, with the value of its parameter."""
    hypothesis = bank.hypotheses[number]
    values = {index: PARAMETERS[index].shown(float(bank.mean[number, index])) for index in hypothesis.sigmas}
    return ', and '.join(part.text.format(value=next(iter(values.values()), 0.0)) for part in _parts(hypothesis))
