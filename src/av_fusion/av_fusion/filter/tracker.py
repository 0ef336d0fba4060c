"""A Bayes filter on the circle: both mirror images of a sound live as modes of one posterior until evidence decides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import remainder, tau

from av_common.track import Source, State, Track
from av_fusion.calibration.array_calibration import LEAST_CONFIDENCE, Pair, Refinement, RefinementSettings, SeenCourse
from av_fusion.disambiguation.rotation import Image, RotationPlanner, RotationSettings
from av_fusion.filter.coasting import LastKnown
from av_fusion.filter.gaussian_component import Mode, Motion, gaussian, share_within
from av_fusion.filter.gaussian_mixture import Mixture, Newborn
from av_fusion.filter.outlier_rate import Trust
from av_fusion.filter.process_noise import LEAST_SEEN, Agility
from av_fusion.filter.sound_likelihood import Directions, MirrorImages
from av_fusion.filter.state_machine import MachineSettings, StateMachine
from av_fusion.measurement.measurements import CameraMeasurement, Detection, DoaMeasurement, usable_camera, usable_doa
from av_fusion.measurement.rig_motion import RigMotion

UNIFORM = 1.0 / (2.0 * math.pi)
SOURCES = {(0.0, 0.0): Source.NOTHING, (1.0, 0.0): Source.SIGHT, (0.0, 1.0): Source.SOUND,
           (1.0, 1.0): Source.SIGHT | Source.SOUND}  # by whether sight and sound are fresh
SEEN_S = 0.5  # a target seen so lately is in sight
MAX_GAP_S = 5.0  # what is this old says nothing of now; a larger jump of the clock starts anew


@dataclass(frozen=True)
class BayesSettings:
    """What the filter believes about targets and senses. Angles in rad, times in s.

    `acceleration_density` (rad^2/s^3) and `rate_sigma` describe how targets move on the circle, `elevation_density`
    (rad^2/s) how their elevation wanders around the usual one; `loss_rate` (1/s) how often
    the target is replaced by another one elsewhere, which is what lets a wrong belief be found out. `otherwise_heard` is the
    share of sounds that are taken to come from something else before sight tells better (0: all are the target's). `recall`
    is the chance that a visible target in view is detected. Errors of successive pictures are alike for `sight_correlation` s.
    A track ends when its sigma passes `lost_sigma`, and `coast` s after what is heard and seen ceased to fit it. Front and
    back count as told apart from probability `decide` on, until it falls below `doubt`.
    """

    acceleration_density: float = 0.02
    elevation_density: float = 0.001
    usual_elevation: float = math.radians(10.0)
    usual_elevation_sigma: float = math.radians(10.0)
    rate_sigma: float = 0.3
    loss_rate: float = 0.002
    sound_floor_sigma: float = math.radians(0.5)
    otherwise_heard: float = 0.01
    recall: float = 0.9
    sight_correlation: float = 0.3
    lost_sigma: float = math.radians(30.0)
    coast: float = 3.0
    decide: float = 0.95
    doubt: float = 0.8
    assumed_visibility: float = 0.0
    sound_delay: float = 0.0
    sight_delay: float = 0.0
    machine: MachineSettings = field(default_factory=MachineSettings)
    rotation: RotationSettings = field(default_factory=RotationSettings)
    refinement: RefinementSettings = field(default_factory=RefinementSettings)


class BayesTracker:
    """Mixture of `Mode`s plus a uniform background ("the target is elsewhere, or there is none").

    Sound enters as the mixture of its mirror images and clutter, sight as detections or their absence. Measurements may
    come late and in any order: each counts at its own capture time, turned by the rig's yaw of that time.
    """

    def __init__(self, settings: BayesSettings | None = None) -> None:
        self.settings = settings or BayesSettings()
        self.motion = RigMotion()
        self.machine = StateMachine(self.settings.machine)
        self.planner = RotationPlanner(self.settings.rotation)
        self.refinement = Refinement(self.settings.refinement)
        self._trust = Trust(self.settings.otherwise_heard)
        self.reset()

    def reset(self) -> None:
        """Forget the target, not the rig."""
        self._time: float | None = None
        settings = self.settings
        usual = Motion(settings.acceleration_density, settings.elevation_density,
                       settings.usual_elevation, settings.usual_elevation_sigma**2)
        self._mixture = Mixture(usual, settings.rate_sigma**2, settings.lost_sigma**2)
        self._agility = Agility()
        self._newest_sound = self._newest_look = self._newest_sighting = -math.inf
        self._seen = SeenCourse()
        self._known = LastKnown(self.settings.coast)
        self._resolved = False
        self._visibility = math.nan
        self._axis: float | None = None  # the array's end-fire (body azimuth), about which sounds are mirrored

    def add_pose(self, time: float, yaw: float, yaw_rate: float = 0.0) -> None:
        """The rig's yaw in the world (rad) and its rate (rad/s) at `time`."""
        self.motion.add(time, yaw, yaw_rate)

    def add_doa(self, sound: DoaMeasurement) -> None:
        """Take in a sound; one that makes no sense says nothing."""
        sound = usable_doa(sound)
        if sound is None:
            return
        time = sound.time - self.settings.sound_delay
        yaw, yaw_rate = self.motion.yaw(time), self.motion.yaw_rate(time)
        sound = self._learn(sound, time, yaw)
        heard = sound.hypotheses
        lag = self._advance(time)
        # Windows overlap: each adds the part that is new, as if its noise were that much larger.
        fresh = _fresh(time, self._newest_sound, sound.window)
        since = max(time - self._newest_sound, 0.0)
        self._newest_sound = max(self._newest_sound, time)
        floor, smear = self.settings.sound_floor_sigma**2, (yaw_rate * sound.window) ** 2 / 48.0
        azimuths = [remainder(yaw + h.azimuth, tau) for h in heard]
        variances = [(h.azimuth_variance + floor + smear) / fresh for h in heard]
        prior = sound.confidence / len(heard)
        clutter = max(1.0 - sound.confidence, 1e-3)
        sharpness = prior / math.sqrt(2.0 * math.pi * min(variances) * fresh) / UNIFORM
        if len(heard) == 2:
            self._axis = heard[0].azimuth + 0.5 * remainder(heard[1].azimuth - heard[0].azimuth, tau)
            measured = MirrorImages(azimuths, variances)
            if measured.half**2 > 4.0 * fresh * variances[0]:
                self._mixture.split(measured.axis, lag)
        else:
            self._axis, measured = None, Directions(azimuths, variances)
        width = min(sound.confidence / sharpness, 1.0)  # share of the circle that it points at
        stray, peak = clutter**fresh, sharpness**fresh
        anywhere = stray + peak * width / math.sqrt(fresh)
        self._mixture.wonder(since, self._trust.otherwise(sound.confidence), width)
        compared = [measured.compare(mode, lag) for mode in self._mixture.modes]
        for mode, _, variance, innovation, _ in compared:
            self._agility.note(mode.weight * (1.0 - mode.misled), mode.rate, innovation, variance)
        self._mixture.listen([stray + fit * peak for _, _, _, _, fit in compared], anywhere)
        for mode, row, variance, innovation, fit in compared:
            mode.update(row, variance, innovation, (1.0 - mode.misled) * fit * sharpness / (clutter + fit * sharpness))
        self._agility.adapt(fresh)
        born = fresh * (1.0 - self._mixture.misled)
        self._mixture.give_birth(lag, self._agility.value, [
            Newborn(azimuth, variance * fresh, prior * born) for azimuth, variance in zip(azimuths, variances, strict=True)])
        self._mixture.background *= 1.0 - (1.0 - clutter) * born  # what went to the newborns
        self._mixture.tidy()
        self.machine.hear(time, sound.confidence)

    def _learn(self, sound: DoaMeasurement, time: float, yaw: float) -> DoaMeasurement:
        """The sound as corrected by what was seen so far, after comparing it with what was seen at its time."""
        seen = self._seen.at(time)
        azimuth = 0.0 if seen is None else remainder(seen[0] - yaw, tau)
        pair = Pair.of(sound) if self.settings.refinement.enabled else None
        if pair is not None:
            if seen is not None and sound.confidence >= LEAST_CONFIDENCE:
                fresh = _fresh(time, self._newest_sound, sound.window)
                variance = sound.hypotheses[0].azimuth_variance + self.settings.sound_floor_sigma**2
                self.refinement.compare(time, math.cos(pair.half), remainder(azimuth - pair.axis, tau), seen[1],
                                        max(variance * math.sin(pair.half) ** 2, 1e-5) / fresh, seen[2])
            sound = pair.corrected(sound, self.refinement)
        if seen is not None:
            self._trust.compare(sound, time, azimuth)
        return sound

    def add_camera(self, look: CameraMeasurement) -> None:
        """Take in a picture: its detections, and what their absence is worth where one could have seen."""
        look = usable_camera(look)
        if look is None:
            return
        time = look.time - self.settings.sight_delay
        lag = self._advance(time)
        settings = self.settings
        # What is seen for the first time, or again, is news, however many pictures did not show it.
        fresh = _fresh(time, self._newest_sighting if look.detections else self._newest_look, settings.sight_correlation)
        self._newest_look = max(self._newest_look, time)
        if look.detections:
            self._newest_sighting = max(self._newest_sighting, time)
        self._visibility = look.visibility
        visibility = look.visibility if math.isfinite(look.visibility) else settings.assumed_visibility
        yaw, width = self.motion.yaw(time), 2.0 * look.half_view
        seen = look.detections
        azimuths = [remainder(yaw + d.azimuth, tau) for d in seen]
        odds = [min(d.confidence / max(1.0 - d.confidence, 0.01), 99.0) for d in seen]
        confidence, best = 0.0, self._mixture.primary()
        for mode in self._mixture.modes:
            expected = mode.expected_variance(lag)
            in_view = share_within(look.half_view, mode.innovation(yaw + look.view_azimuth, lag), expected)
            likelihood = missed = mode.miss(time, visibility, in_view * settings.recall, fresh)
            if seen:
                innovations = [mode.innovation(azimuth, lag) for azimuth in azimuths]
                found = [settings.recall * o * width * gaussian(nu, expected + d.azimuth_variance)
                         for o, nu, d in zip(odds, innovations, seen, strict=True)]
                likelihood += sum(found)
                shares = [f / likelihood for f in found]
                confident = self._associate(mode, lag, innovations, shares, seen)
                confidence = confident if mode is best else confidence
                mode.hidden *= missed / likelihood  # what was detected is not hidden
            mode.weight *= max(likelihood, 1e-3) ** fresh
        view_share = width * UNIFORM
        self._mixture.background *= (1.0 - view_share * settings.recall * visibility) ** fresh
        if seen:
            self._agility.adapt(fresh)
            clear = look.best
            if clear.confidence >= LEAST_CONFIDENCE:
                self._seen.add(time, remainder(yaw + clear.azimuth, tau), clear.elevation, clear.azimuth_variance)
            # A calibrated confidence is the probability that this is the target, wherever it was thought to be.
            self._mixture.give_birth(lag, self._agility.value, [
                Newborn(azimuth, d.azimuth_variance, o * fresh, d, o)
                for azimuth, d, o in zip(azimuths, seen, odds, strict=True)])
            confidence = clear.confidence if best is None else confidence
        self._mixture.tidy()
        self.machine.see(time, confidence)

    def _associate(self, mode: Mode, lag: float, innovations: Sequence[float], shares: Sequence[float],
                   seen: Sequence[Detection]) -> float:
        """Correct a mode by detections, of which each has its share; the confidence of that which it rests on, else 0."""
        # Also where it does not belong yet: a target that swerves is nearly lost.
        innovation, nearest = min(zip(innovations, seen, strict=True), key=lambda pair: abs(pair[0]))
        self._agility.note(mode.weight, mode.rate, innovation, mode.expected_variance(lag) + nearest.azimuth_variance)
        mode.update_azimuth(lag, innovations, [d.azimuth_variance for d in seen], shares)
        confidence = 0.0
        for detection, share in zip(seen, shares, strict=True):
            mode.update_elevation(detection.elevation, detection.elevation_variance, share)
            if share > 0.5:
                confidence = detection.confidence
        return confidence

    def estimate(self, time: float) -> Track:
        """The track at `time`, which may lie ahead of the newest measurement; the filter itself is not moved."""
        machine, primary = self.machine, self._mixture.primary()
        ahead = 0.0 if self._time is None else time - self._time
        variance = math.inf if primary is None else primary.expected_variance(-ahead)
        tracking = (primary is not None and self._mixture.background < 0.5 and variance < self.settings.lost_sigma**2
                    and ahead < MAX_GAP_S)
        yaw = self.motion.yaw(time)
        carried = None
        if not tracking and ahead < MAX_GAP_S:
            carried = self._known.carried(time, yaw, self._agility.value * self.settings.acceleration_density)
        state = machine.step(time, tracking, carried is not None)
        if not tracking:
            self._resolved = False
            self.planner.cancel()
            return (carried or Track(time))._replace(
                state=state, reason=machine.reason, changed=machine.changed, sound_confidence=machine.sound_confidence,
                sight_confidence=machine.sight_confidence, visibility=self._visibility)
        azimuth_world = remainder(primary.azimuth + ahead * primary.rate, tau)
        front = self._mixture.front_probability(yaw, ahead)
        share = self._mixture.share_of(primary, math.nan if self._axis is None else yaw + self._axis)
        decided = share >= self.settings.decide and max(front, 1.0 - front) >= self.settings.decide
        self._resolved = decided or self._axis is None or (self._resolved and share >= self.settings.doubt)
        sight_weight = 1.0 if state == State.VISUAL_ACTIVE else 0.0
        sound_weight = 1.0 if time - self._newest_sound <= machine.settings.sound_timeout else 0.0
        track = Track(  # in the order of its fields: their names would cost a fifth of all that is done here
            time, state, machine.reason, machine.changed, SOURCES[sight_weight, sound_weight],
            remainder(azimuth_world - yaw, tau), primary.elevation,
            variance, primary.elevation_variance if primary.seen else math.inf,
            azimuth_world, primary.rate, max(self._newest_sound, self._newest_look),
            front, self._resolved, self._rotation(time, yaw, share),
            machine.sound_confidence, machine.sight_confidence,
            sound_weight * (1.0 - 0.5 * sight_weight), sight_weight * (1.0 - 0.5 * sound_weight), self._visibility)
        self._known.keep(track, primary.rate_variance)
        return track

    def diagnostics(self) -> dict[str, str]:
        """See `Tracker`."""
        learned = self.refinement.describe() if self.refinement.compared else {}
        return {**self.machine.diagnostics(), **{f'array self-calibration: {name}': value for name, value in learned.items()}}

    def _advance(self, time: float) -> float:
        """Predict to `time`; returns how long ago it is when the filter is already past it."""
        if self._time is not None and abs(time - self._time) > MAX_GAP_S:
            self.reset()
        if self._time is None:
            self._time = time
        dt = time - self._time
        if dt <= 0.0:
            return -dt
        kept = math.exp(-self.settings.loss_rate * dt)
        seen = time - self._newest_sighting < SEEN_S
        self._mixture.predict(dt, max(self._agility.value, LEAST_SEEN) if seen else self._agility.value, kept)
        self._time = time
        return 0.0

    def _rotation(self, time: float, yaw: float, share: float) -> float:
        if self._resolved:
            self.planner.cancel()
            return 0.0
        return self.planner.plan(time, yaw, lambda: self._images(yaw, share), self._axis, self._visibility)

    def _images(self, yaw: float, share: float) -> list[Image]:
        """Where the target may be, seen from the rig at `yaw`."""
        images = [Image(remainder(mode.azimuth - yaw, tau), mode.azimuth_variance, mode.rate, mode.rate_variance, mode.weight)
                  for mode in self._mixture.modes]
        if share < self.settings.decide:
            return images
        first = max(images, key=lambda image: image.weight)  # one bearing, on the axis: front or back of it?
        return [first, first._replace(azimuth=remainder(2.0 * self._axis - first.azimuth, tau), rate=-first.rate)]


def _fresh(time: float, newest: float, correlation: float) -> float:
    """Share of new evidence in a measurement whose error is alike for `correlation` s."""
    return min(1.0, max(abs(time - newest) / correlation, 0.02)) if correlation > 0.0 else 1.0
