"""Tracks several targets and follows one of them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from av_common.track import Source, State, Target, Targets, Track
from av_fusion.calibration.array_calibration import ArraySelfCalibration
from av_fusion.calibration.sighting_calibration import SightingCalibration
from av_fusion.disambiguation.rotation import RotationPlanner, Tilt
from av_fusion.filter.camera_looks import CameraLooks
from av_fusion.filter.coasting import CoastingTrack
from av_fusion.filter.doa_likelihood import mirror_axis
from av_fusion.filter.gating import gated_doas, gated_image
from av_fusion.filter.state_machine import StateMachine
from av_fusion.filter.target_density import MAX_GAP_S, TargetDensity
from av_fusion.filter.world_track import placed
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement, usable_camera, usable_doa
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.measurement.vectors import Rows, Vector, turned
from av_fusion.multi_target.bernoulli_track import BernoulliTrack
from av_fusion.multi_target.drone_evidence import DRONE
from av_fusion.multi_target.multi_target_filter import MultiTargetFilter
from av_fusion.multi_target.settings import MultiTargetSettings
from av_fusion.multi_target.target_selector import TargetSelector

SOURCES = {(False, False): Source.NOTHING, (True, False): Source.SIGHT, (False, True): Source.SOUND,
           (True, True): Source.SIGHT | Source.SOUND}  # by whether sight and sound are recent
LEAST_FURTHER = 0.3  # confidence of a further direction of a window: of a lower one it is a reflection rather than a source
JUDGED_S = 1.0  # after which a sound has been judged, if it ever is
UNKNOWN = 0.5  # visibility that is taken for a look while it is unknown: only looking tells


class MultiTargetTracker:
    """A `MultiTargetFilter` of which one target is followed. Implements `Tracker`.

    Attributes:
        settings: see `MultiTargetSettings`.
        motion: the rig's attitude and path over time.
        filter: all tracks.
        machine: which sensor leads for the followed target, and why.
        planner: rotations of the rig that resolve the front-back ambiguities of all targets.
        looks: looks of a camera on a gimbal; None for a fixed camera.

    Parameters:
        settings: see the attribute.
    """

    def __init__(self, settings: MultiTargetSettings | None = None) -> None:
        self.settings = settings or MultiTargetSettings()
        target = self.settings.target
        self.motion = RigMotion()
        self.machine = StateMachine(target.machine)
        self.planner = RotationPlanner(target.rotation)
        self.looks = CameraLooks(target.gimbal, self.settings.dwell) if target.gimbal else None
        self.filter = MultiTargetFilter(self.settings, self.motion)
        self._calibration = SightingCalibration(target, self.motion)
        self.filter.outlier_rate = self._calibration.outlier_rate.rate
        self._coasting = CoastingTrack(target.coast, target.model)
        self._last: Target | None = None  # that was followed last
        self._bystander: DoaMeasurement | None = None  # newest direction of arrival of something else than a drone
        self._newest_doa = -math.inf
        self._selector = TargetSelector(self.settings.policy)
        self._targets = Targets(0.0)
        self._visibility = math.nan
        self._mirror_axis: Vector | None = None  # in the body frame, of the newest direction of arrival

    @property
    def self_calibration(self) -> ArraySelfCalibration:
        """What is known of the array, by comparison with the camera."""
        return self._calibration.array

    def reset(self) -> None:
        """See `Tracker`."""
        self.filter.reset()
        self._calibration.reset()
        self._coasting = CoastingTrack(self.settings.target.coast, self.settings.target.model)
        self._last, self._newest_doa = None, -math.inf
        self._targets = Targets(0.0)
        self._visibility = math.nan
        self._mirror_axis = None

    def add_pose(self, pose: Pose) -> Rows | None:
        """See `Tracker`. Where the attitude jumps, tracks keep their directions in the body: those were measured."""
        jump = self.motion.add(pose)
        if jump is not None:
            self.filter.turn_world(jump)
            self._calibration.turn_world(jump)
            self._coasting.turn_world(jump)
        return jump

    def add_doas(self, measurements: Sequence[DoaMeasurement]) -> None:
        """See `Tracker`."""
        usable = [one for one in map(usable_doa, measurements) if one is not None]
        usable = usable[:1] + [one for one in usable[1:] if one.confidence >= LEAST_FURTHER]
        if not usable:
            return
        time = usable[0].time - self.settings.target.sound_delay
        self._reset_after_gap(time)
        # A sighting is compared with the only sound: of several it is not known which is the one that is seen.
        heard = [self._calibration.correct(one, time, self._newest_doa) if len(usable) == 1
                 else self._calibration.array.corrected(one) for one in map(_of_its_kind, usable)]
        self.filter.update_sound(time, heard)
        led = self._led()
        primary = None if led is None else led.mixture.primary()
        associated = primary is not None and primary.newest_doa >= time
        drones = [one for one in heard if one.is_target] or heard[:associated]
        if drones:
            self._newest_doa = max(self._newest_doa, time)
            self._mirror_axis = mirror_axis(drones[0].hypotheses, drones[0].cone)
            self.machine.on_doa(time, drones[0].confidence, associated)
        self._bystander = next((one for one in heard if not one.is_target), self._bystander)

    def add_doa(self, measurement: DoaMeasurement) -> None:
        """Use the only direction of arrival of a window."""
        self.add_doas([measurement])

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """See `Tracker`."""
        usable = usable_camera(measurement)
        if usable is None:
            return
        time = usable.time - self.settings.target.sight_delay
        self._reset_after_gap(time)
        self._visibility = usable.visibility
        self._calibration.see(time, usable.best if self.filter.alone else None)
        self.filter.update_image(time, usable)
        led = self._led()
        score = led.score if led is not None else usable.best.score if usable.best is not None else 0.0
        self.machine.on_image(time, score)
        if self.looks is not None:
            self.looks.on_image(time, usable, self.motion, score >= self.machine.settings.tau)

    def expected_doas(self, measurements: Sequence[DoaMeasurement]) -> list[DoaMeasurement]:
        """See `Tracker`."""
        return gated_doas(measurements, self.filter.tracks, self.settings.target, self.motion)

    def expected_image(self, measurement: CameraMeasurement) -> CameraMeasurement | None:
        """See `Tracker`."""
        return gated_image(measurement, self.filter.tracks, self.settings.target, self.motion)

    def estimate(self, time: float) -> Track:
        """See `Tracker`: the followed target. The filter itself is not moved."""
        tracks, found = {}, []
        for track in self.filter.tracks:
            likely = track.existence >= self.settings.confirmed and abs(time - self.filter.newest) < MAX_GAP_S
            target = self._target(time, track) if likely else None
            if target is None:
                track.ambiguity.resolved = False
            else:
                tracks[track.id] = track
                found.append(target)
        drones = [target for target in found if not target.drone_probability < DRONE]
        chosen = self._selector.choose(time, _judged(drones, [time - tracks[target.id].began for target in drones]))
        self._targets = Targets(time, tuple(found), chosen)
        if not chosen:
            return self._coast(time)
        state = self.machine.step(time, True)
        followed = self._target(time, tracks[chosen], state == State.VISUAL_ACTIVE)
        assert followed is not None
        self._targets = Targets(time, tuple(followed if target.id == chosen else target for target in found), chosen)
        unresolved = [tracks[target.id] for target in drones]
        return followed.track._replace(
            state=state, reason=self.machine.reason, changed=self.machine.changed,
            requested_rotation=self._plan_rotation(time, unresolved), look=self._plan_look(time, state, unresolved),
            sound_confidence=self.machine.sound_confidence, sight_confidence=self.machine.sight_confidence,
            visibility=self._visibility)

    def _coast(self, time: float) -> Track:
        """The track that was followed last, predicted; else none."""
        machine, predicted, target = self.machine, None, self._last
        if target is not None and abs(time - self.filter.newest) < MAX_GAP_S:
            led = self._led()
            predicted = self._coasting.predicted(time, self.motion, 1.0 if led is None else led.noise_scale(time))
        state = machine.step(time, False, predicted is not None)
        self.planner.cancel()
        track = (predicted or Track(time, attitude_known=self.motion.is_known(time)))._replace(
            state=state, reason=machine.reason, changed=machine.changed, sound_confidence=machine.sound_confidence,
            sight_confidence=machine.sight_confidence, visibility=self._visibility)
        if predicted is not None and target is not None:
            others = tuple(other for other in self._targets.targets if other.id != target.id)
            found = sorted((*others, target._replace(track=track)), key=lambda each: each.id)
            self._targets = Targets(time, tuple(found), target.id)
        return track

    def targets(self, track: Track) -> Targets:
        """See `Tracker`."""
        return self._targets

    def densities(self) -> list[TargetDensity]:
        """See `Tracker`."""
        return list(self.filter.tracks)

    def select(self, identifier: int) -> None:
        """See `Tracker`."""
        if identifier and all(target.id != identifier for target in self._targets.targets):
            raise ValueError(f'target {identifier} is not tracked')
        self._selector.want(identifier)

    def diagnostics(self) -> dict[str, str]:
        """See `Tracker`."""
        found = {**self.machine.diagnostics(), 'targets': str(len(self._targets.targets))}
        if self._bystander is not None:
            azimuths = ' or '.join(f'{math.degrees(h.azimuth):.0f}' for h in self._bystander.hypotheses)
            found['newest bystander'] = f'at {self._bystander.time:.1f} s, azimuth {azimuths} deg'
        return {**found, **self._calibration.diagnostics()}

    def _led(self) -> BernoulliTrack | None:
        """The followed target, or the one that would be."""
        followed = next((track for track in self.filter.tracks if track.id == self._targets.selected), None)
        drones = [track for track in self.filter.tracks if track.is_drone]
        return followed or max(drones, key=lambda track: track.existence, default=None)

    def _reset_after_gap(self, time: float) -> None:
        if math.isfinite(self.filter.newest) and abs(time - self.filter.newest) > MAX_GAP_S:
            self.reset()

    def _target(self, time: float, track: BernoulliTrack, led_by_sight: bool | None = None) -> Target | None:
        """A track predicted to `time`; None where its direction is lost by then.

        Parameters:
            time (s): the present.
            track: the track.
            led_by_sight: whether sight leads for the followed target; None for others.
        """
        primary, mixture = track.mixture.primary(), track.mixture
        if primary is None or track.time is None:
            return None
        ahead, noise, moved = time - track.time, track.noise_scale(time), self.motion.moved(track.time, time)
        later = mixture.predicted(primary, ahead, noise, moved)
        settings = self.settings.target
        if later.across_variance >= settings.lost_sigma**2:
            return None
        attitude = self.motion.attitude(time)
        front = mixture.front_probability(attitude, ahead, noise, moved)
        track.ambiguity.decide(mixture, primary, front, self._mirror_axis, attitude)
        seen = led_by_sight
        if seen is None:
            seen = time - primary.newest_sighting <= settings.machine.sight_timeout
        heard = time - primary.newest_doa <= settings.machine.sound_timeout
        source = SOURCES[seen, heard]
        state = (State.VISUAL_ACTIVE if source & Source.SIGHT else State.ACOUSTIC_ACTIVE if source & Source.SOUND
                 else State.COASTING)
        axis = None if seen or self._mirror_axis is None else turned(attitude, self._mirror_axis)
        shown = later.with_variance(track.variance_scale(time, seen), axis)
        target = Target(track.id, track.existence, placed(Track(
            time=time, state=state, source=source, measured=primary.measured, front_probability=front,
            resolved=track.ambiguity.resolved, sound_weight=heard * (1.0 - 0.5 * seen),
            sight_weight=seen * (1.0 - 0.5 * heard)), shown, self.motion), track.kind.probability, primary.newest_doa,
            primary.newest_sighting, track.identity, track.blade_pass.type_of(self.settings.types), track.blade_pass.frequency)
        if led_by_sight is not None:
            self._coasting.keep(target.track, later)
            self._last = target
        return target

    def _plan_rotation(self, time: float, tracks: Sequence[BernoulliTrack]) -> float:
        """The rotation (rad) that resolves the ambiguities of all tracks soonest."""
        axis, unresolved = self._mirror_axis, [track for track in tracks if not track.ambiguity.resolved]
        if not unresolved or axis is None:
            self.planner.cancel()
            return 0.0
        yaw = self.motion.yaw(time)
        tilt = Tilt.of(self.motion.attitude(time), yaw, self.motion.rate(time), axis)
        return self.planner.plan(time, yaw, lambda: [track.ambiguity.candidates(track.mixture, yaw, tilt.axis)
                                                     for track in unresolved], tilt, self._visibility)

    def _plan_look(self, time: float, state: State, tracks: Sequence[BernoulliTrack]) -> tuple[float, float] | None:
        """Where a look decides most about the tracks that are not resolved, or else finds the followed or the next one."""
        if self.looks is None or self.planner.is_asked(time):
            return None
        visits = self.settings.visits and len(tracks) > 1
        followed = 0 if visits else self._targets.selected
        wanted = [track for track in tracks if not track.ambiguity.resolved or track.id == followed]
        visibility = (self._visibility if math.isfinite(self._visibility)
                      else max(self.settings.target.assumed_visibility, UNKNOWN))
        visible, look = visibility * self.settings.target.detection_probability, None
        if not wanted or (state == State.VISUAL_ACTIVE and not visits):
            self.looks.planner.cancel()
        else:
            components = [component for track in wanted for component in track.mixture.components]
            look = self.looks.plan(time, components, visible, self.motion)
        if look is None and visits:
            targets = {track.id: primary for track in tracks if (primary := track.mixture.primary()) is not None}
            look = self.looks.visit(time, targets, {track.id: track.existence for track in tracks}, visible, self.motion)
        return look


def _judged(targets: Sequence[Target], ages: Sequence[float]) -> Sequence[Target]:
    """The targets without those that are not judged yet, where there are several: one of them may be a bystander.

    Parameters:
        targets: tracks that may be drones.
        ages (s): time since each began; what is not judged by JUDGED_S counts as a drone.
    """
    if len(targets) < 2:
        return targets
    return [target for target, age in zip(targets, ages, strict=True)
            if age >= JUDGED_S or not math.isnan(target.drone_probability)]


def _of_its_kind(measurement: DoaMeasurement) -> DoaMeasurement:
    """The measurement with the probability that there is a source, and that it is of the kind for which it is taken."""
    target = measurement.target_probability
    return measurement._replace(confidence=measurement.confidence * max(target, 1.0 - target))
