"""Tracks several targets and follows one of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from av_common.rig import GimbalMount
from av_common.track import Source, State, Target, Targets, Track
from av_fusion.calibration.array_calibration import ArraySelfCalibration
from av_fusion.calibration.sighting_calibration import SightingCalibration
from av_fusion.disambiguation.ambiguity import candidates, is_resolved
from av_fusion.disambiguation.look import LookPlanner
from av_fusion.disambiguation.rotation import NO_CAMERA, RotationPlanner
from av_fusion.identity.selection import Selection
from av_fusion.measurement.measurements import LEAST_LEVEL, CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.measurement.vectors import Vector, heading, turned, turned_back
from av_fusion.plain_tracker import FORGET_S
from av_fusion.state_machine import SIGHT_TIMEOUT_S, SOUND_TIMEOUT_S, StateMachine
from av_fusion.tracks.component import BodyDirection, GaussianComponent
from av_fusion.tracks.filter import LOOK_S, MultiBernoulliFilter
from av_fusion.tracks.likelihood import mirror_axis
from av_fusion.tracks.settings import FilterSettings
from av_fusion.tracks.track import MAX_GAP_S
from av_fusion.tracks.track import Track as FilterTrack

KNOWN_RANGE = 2.0  # inverse range over its standard deviation from which a range is published
UNKNOWN = 0.5  # visibility by which looks and rotations are planned while it is unknown: only looking tells


@dataclass(frozen=True)
class TrackerSettings:
    """Settings of `MultiTargetTracker`.

    Parameters:
        filter: models of targets and sensors.
        tau: score of a detection from which the camera leads.
        confirm_threshold: probability from which the front-back ambiguity counts as resolved.
        rotation: whether rotations are requested.
        self_calibration: whether the array is calibrated by the camera.
        follow_threshold: probability of a drone from which a target is followed.
        policy: which target is followed, see `Selection`.
        gimbal: the gimbal that carries the camera, which then looks where the target is heard; None for a fixed camera.
        types: blade-pass frequency (Hz) of each type of drone that is named when it is heard.
        sound_delay, sight_delay (s): delay of the stamps of directions of arrival and of images.
    """

    filter: FilterSettings = field(default_factory=FilterSettings)
    tau: float = 0.5
    confirm_threshold: float = 0.95
    rotation: bool = True
    self_calibration: bool = True
    follow_threshold: float = 0.5
    policy: str = 'certain'
    gimbal: GimbalMount | None = None
    types: dict[str, float] = field(default_factory=dict)
    sound_delay: float = 0.0
    sight_delay: float = 0.0


class MultiTargetTracker:
    """A `MultiBernoulliFilter` of which one target is followed. Implements `Tracker`.

    Attributes:
        settings: see `TrackerSettings`.
        motion: the rig's attitude and path over time.
        filter: all tracks.
        machine: which sensor leads for the followed target, and why.
        planner: rotations of the rig that resolve the front-back ambiguities of all targets.
        looks: looks of a camera on a gimbal; None for a fixed camera.

    Parameters:
        settings: see the attribute.
    """

    def __init__(self, settings: TrackerSettings | None = None) -> None:
        self.settings = settings or TrackerSettings()
        self.motion = RigMotion()
        self.machine = StateMachine(self.settings.tau)
        self.planner = RotationPlanner(self.settings.rotation)
        self.filter = MultiBernoulliFilter(self.settings.filter, self.motion)
        self._calibration = SightingCalibration(self.settings.self_calibration,
                                                self.settings.filter.sound_floor_sigma, self.motion)
        self._confirm = self.settings.confirm_threshold
        self._selection = Selection(self.settings.policy, self.settings.follow_threshold)
        self.reset()

    @property
    def self_calibration(self) -> ArraySelfCalibration:
        """What is known of the array, by comparison with the camera."""
        return self._calibration.array

    def reset(self, learned: bool = False) -> None:
        """See `PlainTracker`."""
        self.filter.reset()
        self._calibration.reset(learned)
        self.machine.restart()
        self.planner.cancel()
        self.looks = LookPlanner(self.settings.gimbal) if self.settings.gimbal else None
        self._targets = Targets(0.0)
        self._images: dict[str, CameraMeasurement] = {}  # the newest one of each camera
        self._image = NO_CAMERA  # that of them in which one sees best
        self._mirror_axis: Vector | None = None  # in the body frame, of the newest directions of arrival

    def add_pose(self, pose: Pose) -> None:
        """See `PlainTracker`. Where the attitude jumps, tracks keep their directions in the body: those were measured."""
        jump = self.motion.add(pose, self.filter.newest)
        if jump is not None:
            self.filter.turn_world(jump)
            self._calibration.turn_world(jump)
            if self.looks is not None:
                self.looks.cancel()

    def add_doas(self, measurements: Sequence[DoaMeasurement]) -> None:
        """See `PlainTracker`."""
        if not measurements:
            return
        time = measurements[0].time - self.settings.sound_delay
        self._reset_after_gap(time)
        self._mirror_axis = next((axis for one in measurements
                                  if (axis := mirror_axis(one.hypotheses, one.cone)) is not None), None)
        # A sighting is compared with the only sound: of several it is not known which is the one that is seen.
        heard = [self._calibration.correct(one, time, self.filter.newest_doa) if len(measurements) == 1
                 else self._calibration.array.corrected(one) for one in measurements]
        self.filter.update_sound(time, heard)
        self.machine.on_doa(time, heard[0].confidence)

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """See `PlainTracker`."""
        time = measurement.time - self.settings.sight_delay
        self._reset_after_gap(time)
        # What is heard elsewhere may be the target by an array that is not calibrated: only a second one that is seen counts.
        seen = [track for track in self.filter.confirmed if time - track.seen < MAX_GAP_S]
        measurement = self._calibration.align(time, measurement, len(seen) > 1)
        self._images[measurement.camera] = measurement
        self.filter.update_image(time, measurement)
        followed = next((track for track in self.filter.tracks if track.id == self._targets.selected), None)
        score = followed.score if followed is not None else measurement.best.score if measurement.best is not None else 0.0
        if score > 0.0 or measurement.searched == 1.0:    # else it may not have been looked for
            self.machine.on_image(time, score, measurement.camera)
        if self.looks is not None:
            self.looks.on_image(time, measurement, self.motion, 0.0 < score >= self.machine.tau)

    def use_cue(self, cue: Vector, variance: float, wrong: float) -> None:
        """See `PlainTracker`."""
        for track in self.filter.tracks:
            track.mixture.weigh_by_cue(cue, variance, wrong)

    def estimate(self, time: float) -> Track:
        """See `PlainTracker`: the followed target. The filter itself is not moved."""
        silent = abs(time - self.filter.newest) >= MAX_GAP_S
        recent = [one for one in self._images.values() if time - one.time < MAX_GAP_S]  # one that has stopped tells nothing
        self._image = max(recent, key=lambda one: one.visibility if math.isfinite(one.visibility) else -1.0, default=NO_CAMERA)
        tracks = {} if silent else {track.id: track for track in self.filter.confirmed}
        found = [target for track in tracks.values() if (target := self._target(time, track)) is not None]
        known = [target for target in found  # what a person wants is not waited for
                 if len(found) < 2 or target.id == self._selection.wanted or self._is_judged(time, target, tracks)]
        chosen = self._selection.choose(known)
        self._targets = Targets(time, tuple(found), chosen)
        followed = next((target for target in found if target.id == chosen), None)
        if followed is None:
            return self._without_target(time, found)
        state = self.machine.step(time, True, heard=followed.heard)
        if self.looks is not None and state == State.VISUAL_ACTIVE:
            self.looks.cancel()
        source = Source.NOTHING if state == State.COASTING else followed.track.source
        wanted = [target for target in found if self._selection.is_followed(target)]
        unresolved = [tracks[target.id] for target in wanted if not target.track.resolved]
        return followed.track._replace(
            state=state, source=source, reason=self.machine.reason, changed=self.machine.changed,
            requested_rotation=self._plan_rotation(time, unresolved),
            look=None if state == State.VISUAL_ACTIVE else self._plan_look(time, [*unresolved, tracks[chosen]]),
            sound_confidence=self.machine.sound_confidence, sight_confidence=self.machine.sight_confidence,
            visibility=self._image.visibility)

    @staticmethod
    def _is_judged(time: float, target: Target, tracks: Mapping[int, FilterTrack]) -> bool:
        """Whether it is known what a target is, or will not be: of several, one may be a bystander."""
        return not math.isnan(target.drone_probability) or time - tracks[target.id].began >= LOOK_S

    def _without_target(self, time: float, found: Sequence[Target]) -> Track:
        """Nothing is followed; the reason names what is tracked all the same."""
        self.planner.cancel()
        state = self.machine.step(time, False, _why_not_followed(found))
        return Track(time, state, self.machine.reason, self.machine.changed, attitude_known=self.motion.is_known(time),
                     sound_confidence=self.machine.sound_confidence, sight_confidence=self.machine.sight_confidence,
                     visibility=self._image.visibility)

    def targets(self, track: Track) -> Targets:
        """See `PlainTracker`."""
        return self._targets

    def densities(self) -> list[FilterTrack]:
        """See `PlainTracker`."""
        return list(self.filter.tracks)

    def select(self, identifier: int) -> None:
        """See `PlainTracker`."""
        if identifier and all(target.id != identifier for target in self._targets.targets):
            raise ValueError(f'target {identifier} is not tracked')
        self._selection.wanted = identifier

    def tune(self, tau: float, confirm_threshold: float) -> None:
        """See `PlainTracker`."""
        self.machine.tau = tau
        self._confirm = confirm_threshold

    def forget_emitters(self) -> int:
        """See `PlainTracker`."""
        known = [track for track in self.filter.tracks if track.kind.is_fixed]
        for track in self.filter.tracks:
            track.kind.static_s = 0.0
        return len(known)

    def diagnostics(self) -> dict[str, str]:
        """See `PlainTracker`."""
        found = {**self.machine.diagnostics(), 'targets': str(len(self._targets.targets))}
        for track in self.filter.tracks:
            primary = track.mixture.primary()
            if track.kind.is_fixed and primary is not None:
                found[f'fixed emitter {track.id}'] = f'at {math.degrees(primary.azimuth):.0f} deg in the world'
            if primary is not None and primary.on_rig:
                body = primary.in_body(self.motion.attitude(track.time))
                found[f'own sound {track.id}'] = f'at {math.degrees(body.azimuth):.0f} deg in the body'
        return {**found, **self._calibration.diagnostics()}

    def _reset_after_gap(self, time: float) -> None:
        if math.isfinite(self.filter.newest) and abs(time - self.filter.newest) > MAX_GAP_S:
            self.reset()

    def _target(self, time: float, track: FilterTrack) -> Target | None:
        """A track predicted to `time` (s); None where it is too long not measured."""
        primary = track.mixture.primary()
        if primary is None or time - primary.measured > FORGET_S + SOUND_TIMEOUT_S:
            return None
        later, attitude = track.later(time), self.motion.attitude(time)
        found = {component: one.in_body(attitude) for component, one in later.items() if one.on_rig == primary.on_rig}
        front = (sum([component.weight * one.front_share for component, one in found.items()])
                 / sum([component.weight for component in found]))
        track.resolved = self._mirror_axis is None or is_resolved(track.mixture, primary, front, attitude, self._confirm,
                                                                  track.resolved)
        seen = time - primary.newest_sighting <= SIGHT_TIMEOUT_S
        heard = time - primary.newest_doa <= SOUND_TIMEOUT_S
        source = Source(seen * Source.SIGHT | heard * Source.SOUND)
        shown = _placed(Track(time=time, source=source, measured=primary.measured, front_probability=front,
                             resolved=track.resolved, sound_weight=heard * (1.0 - 0.5 * seen),
                             sight_weight=seen * (1.0 - 0.5 * heard)), later[primary], found[primary], self.motion)
        return Target(track.id, track.existence, shown, track.drone, primary.newest_doa, primary.newest_sighting,
                      track.blade_pass.type_of(self.settings.types), track.blade_pass.frequency, track.mixture.on_rig)

    @property
    def _expected_visibility(self) -> float:
        """Visibility (0..1) by which looks and rotations are planned."""
        known = self._image.visibility
        return known if math.isfinite(known) else max(self.settings.filter.assumed_visibility, UNKNOWN)

    def _plan_rotation(self, time: float, tracks: Sequence[FilterTrack]) -> float:
        """The rotation (rad) that resolves the ambiguities of all tracks soonest."""
        if not tracks or self._mirror_axis is None:
            self.planner.cancel()
            return 0.0
        yaw = self.motion.yaw(time)
        axis = turned_back(heading(yaw), turned(self.motion.attitude(time), self._mirror_axis))
        return self.planner.plan(time, yaw, lambda: [candidates(track.mixture, yaw, axis, self._confirm) for track in tracks],
                                 axis, self._image._replace(visibility=self._expected_visibility), self._confirm)

    def _plan_look(self, time: float, tracks: Sequence[FilterTrack]) -> tuple[float, float] | None:
        """Where a look decides most about tracks, of which the last one is followed."""
        if self.looks is None or self.planner.is_asked(time):
            return None
        components = [component for track in {track.id: track for track in tracks}.values()
                      for component in track.mixture.likely]
        visible = self._expected_visibility * self.settings.filter.detection_probability
        return self.looks.plan(time, components, visible, self.motion)


def _why_not_followed(found: Sequence[Target]) -> str:
    """What is heard or seen although nothing is followed; empty for nothing."""
    target = max(found, key=lambda each: each.existence, default=None)
    if target is None:
        return ''
    sensed = 'seen' if target.track.source & Source.SIGHT else 'heard'
    judged = (f'turns with the rig ({target.on_rig:.2f})' if target.on_rig > 0.5 else
              'not judged yet' if math.isnan(target.drone_probability) else
              f'judged not a drone ({target.drone_probability:.2f})')
    return f'{sensed} at {math.degrees(target.track.azimuth):+.0f} deg, {judged}'


def _placed(track: Track, component: GaussianComponent, found: BodyDirection, motion: RigMotion) -> Track:
    """A track with the direction, rates and range of a component at the track's time.

    Parameters:
        track: all but these.
        component: the component at that time.
        found: its direction in the body.
        motion: attitude and path of the rig.
    """
    across_rate, up_rate = component.rates(motion.velocity(track.time))
    (hh, hv), (_, vv) = component.covariance[:2, :2].tolist()
    inverse, variance = component.inverse_range, float(component.covariance[4, 4])
    known = inverse > KNOWN_RANGE * math.sqrt(variance)
    return track._replace(
        azimuth=found.azimuth, elevation=found.elevation,
        azimuth_variance=found.azimuth_variance + motion.turn_variance(track.time),
        elevation_variance=found.elevation_variance if component.elevation_measured else math.inf,
        azimuth_world=component.azimuth, azimuth_world_rate=across_rate / max(math.cos(component.elevation), LEAST_LEVEL),
        elevation_world=component.elevation, elevation_world_rate=up_rate, covariance_world=(hh, hv, hv, vv),
        attitude_known=motion.is_known(track.time), range=1.0 / inverse if known else math.nan,
        range_variance=variance / inverse**4 if known else math.inf)
