"""A Bayes filter on the sphere that keeps the mirror images of a direction of arrival as components until evidence decides."""

from __future__ import annotations

import math
from collections.abc import Sequence

from av_common.track import Source, State, Targets, Track
from av_fusion.calibration.array_calibration import ArraySelfCalibration
from av_fusion.calibration.sighting_calibration import SightingCalibration
from av_fusion.disambiguation.rotation import RotationPlanner, Tilt
from av_fusion.filter.ambiguity import Ambiguity
from av_fusion.filter.camera_looks import CameraLooks
from av_fusion.filter.coasting import CoastingTrack
from av_fusion.filter.doa_likelihood import mirror_axis
from av_fusion.filter.posterior import Posterior
from av_fusion.filter.settings import BayesSettings
from av_fusion.filter.single_target import SingleTarget
from av_fusion.filter.state_machine import StateMachine
from av_fusion.filter.target_density import TargetDensity
from av_fusion.filter.world_track import placed
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement, usable_camera, usable_doa
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.measurement.vectors import Rows, Vector, turned

SOURCES = {(0.0, 0.0): Source.NOTHING, (1.0, 0.0): Source.SIGHT, (0.0, 1.0): Source.SOUND,
           (1.0, 1.0): Source.SIGHT | Source.SOUND}  # by whether sight and sound are recent
UNKNOWN = 0.5  # visibility that is taken for a look while it is unknown: only looking tells
MAX_GAP_S = 5.0  # a longer gap between measurements, or jump of the clock, starts a new track
LEAST_TARGET_PROBABILITY = 0.5  # a direction of arrival that is more likely a bystander's is not followed


class BayesTracker:
    """Tracks one target by a mixture of `GaussianComponent`s and a uniform background for a target elsewhere, or none.

    Directions of arrival enter as a mixture of their mirror images and clutter, images as detections or their absence.
    Measurements may arrive late and in any order: each counts at its own capture time, turned by the rig's attitude of that
    time. Implements `Tracker`.

    Attributes:
        settings: see `BayesSettings`.
        motion: the rig's attitude and path over time.
        machine: which sensor leads, and why.
        planner: rotations of the rig that resolve the front-back ambiguity.
        looks: looks of a camera on a gimbal; None for a fixed camera.
        bystander: newest direction of arrival of something else than a drone; None without one.

    Parameters:
        settings: see the attribute.
    """

    def __init__(self, settings: BayesSettings | None = None) -> None:
        self.settings = settings or BayesSettings()
        self.motion = RigMotion()
        self.machine = StateMachine(self.settings.machine)
        self.planner = RotationPlanner(self.settings.rotation)
        self.looks = CameraLooks(self.settings.gimbal) if self.settings.gimbal else None
        self._calibration = SightingCalibration(self.settings, self.motion)
        self._posterior = Posterior(self.settings, self.motion)
        self._coasting = CoastingTrack(self.settings.coast, self.settings.model)
        self.bystander: DoaMeasurement | None = None
        self._target = SingleTarget()
        self._ambiguity = Ambiguity(self.settings.confirm_threshold, self.settings.release_threshold)
        self._visibility = math.nan
        self._mirror_axis: Vector | None = None  # in the body frame, of the newest direction of arrival

    @property
    def self_calibration(self) -> ArraySelfCalibration:
        """What is known of the array, by comparison with the camera."""
        return self._calibration.array

    def reset(self) -> None:
        """See `Tracker`."""
        self._posterior = Posterior(self.settings, self.motion)
        self._calibration.reset()
        self._coasting = CoastingTrack(self.settings.coast, self.settings.model)
        self._ambiguity.resolved = False
        self._visibility = math.nan
        self._mirror_axis = None

    def add_pose(self, pose: Pose) -> Rows | None:
        """See `Tracker`. Where the attitude jumps, the track keeps its direction in the body: that was measured."""
        jump = self.motion.add(pose)
        if jump is not None:
            self._posterior.mixture.turn_world(jump)
            self._calibration.turn_world(jump)
            self._coasting.turn_world(jump)
        return jump

    def add_doas(self, measurements: Sequence[DoaMeasurement]) -> None:
        """See `Tracker`. Of several sources in a window one is the target: the likeliest."""
        usable = [one for one in map(usable_doa, measurements) if one is not None]
        self.bystander = next((one for one in usable if one.target_probability < LEAST_TARGET_PROBABILITY), self.bystander)
        if usable:
            self.add_doa(max(usable, key=lambda one: one.target_confidence))

    def add_doa(self, measurement: DoaMeasurement) -> None:
        """Use one direction of arrival."""
        usable = usable_doa(measurement)
        if usable is None:
            return
        if usable.target_probability < LEAST_TARGET_PROBABILITY:
            self.bystander = usable
            return
        usable = usable._replace(confidence=usable.target_confidence)
        time = usable.time - self.settings.sound_delay
        corrected = self._calibration.correct(usable, time, self._posterior.newest_doa)
        self._reset_after_gap(time)
        self._mirror_axis = mirror_axis(corrected.hypotheses, corrected.cone)
        self._posterior.update_doa(time, corrected, self._calibration.outlier_rate.rate(corrected.confidence))
        primary = self._posterior.mixture.primary()
        self.machine.on_doa(time, corrected.confidence, primary is not None and primary.newest_doa >= time)

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """See `Tracker`."""
        usable = usable_camera(measurement)
        if usable is None:
            return
        time = usable.time - self.settings.sight_delay
        self._reset_after_gap(time)
        self._visibility = usable.visibility
        self._calibration.see(time, usable.best)
        score = self._posterior.update_camera(time, usable)
        self.machine.on_image(time, score)
        if self.looks is not None:
            self.looks.on_image(time, usable, self.motion, score >= self.settings.machine.tau)

    def estimate(self, time: float) -> Track:
        """See `Tracker`. The posterior itself is not moved."""
        posterior, machine = self._posterior, self.machine
        primary = posterior.mixture.primary()
        ahead = 0.0 if posterior.time is None else time - posterior.time
        noise_scale = posterior.noise_scale(time)
        if primary is None or posterior.time is None or posterior.mixture.background >= 0.5 or ahead >= MAX_GAP_S:
            return self._coast(time, ahead)
        moved = self.motion.moved(posterior.time, time)
        later = posterior.mixture.predicted(primary, ahead, noise_scale, moved)
        if later.across_variance >= self.settings.lost_sigma**2:
            return self._coast(time, ahead)
        state, attitude = machine.step(time, True), self.motion.attitude(time)
        front = posterior.mixture.front_probability(attitude, ahead, noise_scale, moved)
        self._ambiguity.decide(posterior.mixture, primary, front, self._mirror_axis, attitude)
        sight = 1.0 if state == State.VISUAL_ACTIVE else 0.0
        sound = 1.0 if time - primary.newest_doa <= machine.settings.sound_timeout else 0.0
        track = placed(Track(
            time=time, state=state, reason=machine.reason, changed=machine.changed, source=SOURCES[sight, sound],
            measured=primary.measured, front_probability=front, resolved=self._ambiguity.resolved,
            requested_rotation=self._plan_rotation(time, attitude), look=self._plan_look(time, state),
            sound_confidence=machine.sound_confidence,
            sight_confidence=machine.sight_confidence, sound_weight=sound * (1.0 - 0.5 * sight),
            sight_weight=sight * (1.0 - 0.5 * sound), visibility=self._visibility), later.with_variance(
                posterior.variance_scale(time, sight > 0.0), self._heard_axis(attitude) if sight == 0.0 else None), self.motion)
        self._coasting.keep(track, later)
        return track

    def targets(self, track: Track) -> Targets:
        """See `Tracker`."""
        return self._target.targets(track, max(1.0 - self._posterior.mixture.background, 0.0))

    def densities(self) -> list[TargetDensity]:
        """See `Tracker`."""
        return [self._posterior]

    def select(self, identifier: int) -> None:
        """See `Tracker`."""
        self._target.select(identifier)

    def diagnostics(self) -> dict[str, str]:
        """See `Tracker`."""
        found = self.machine.diagnostics()
        if self.bystander is not None:
            azimuths = ' or '.join(f'{math.degrees(h.azimuth):.0f}' for h in self.bystander.hypotheses)
            found['newest bystander'] = f'at {self.bystander.time:.1f} s, azimuth {azimuths} deg'
        return {**found, **self._calibration.diagnostics()}

    def _reset_after_gap(self, time: float) -> None:
        if self._posterior.time is not None and abs(time - self._posterior.time) > MAX_GAP_S:
            self.reset()

    def _coast(self, time: float, ahead: float) -> Track:
        """The last supported track, predicted; else none."""
        machine, predicted = self.machine, None
        if ahead < MAX_GAP_S:
            predicted = self._coasting.predicted(time, self.motion, self._posterior.noise_scale(time))
        state = machine.step(time, False, predicted is not None)
        self._ambiguity.resolved = False
        self.planner.cancel()
        return (predicted or Track(time, attitude_known=self.motion.is_known(time)))._replace(
            state=state, reason=machine.reason, changed=machine.changed, sound_confidence=machine.sound_confidence,
            sight_confidence=machine.sight_confidence, visibility=self._visibility)

    def _heard_axis(self, attitude: Rows) -> Vector | None:
        """Axis in the world of the cone that the array measures; None for other arrays."""
        return None if self._mirror_axis is None else turned(attitude, self._mirror_axis)

    def _plan_rotation(self, time: float, attitude: Rows) -> float:
        axis = self._mirror_axis
        if self._ambiguity.resolved or axis is None:
            self.planner.cancel()
            return 0.0
        yaw = self.motion.yaw(time)
        tilt = Tilt.of(attitude, yaw, self.motion.rate(time), axis)
        return self.planner.plan(time, yaw, lambda: [self._ambiguity.candidates(self._posterior.mixture, yaw, tilt.axis)], tilt,
                                 self._visibility)

    def _plan_look(self, time: float, state: State) -> tuple[float, float] | None:
        if self.looks is None or self.planner.is_asked(time):
            return None
        if state == State.VISUAL_ACTIVE:
            self.looks.planner.cancel()
            return None
        visibility = self._visibility if math.isfinite(self._visibility) else max(self.settings.assumed_visibility, UNKNOWN)
        visible = visibility * self.settings.detection_probability
        return self.looks.plan(time, self._posterior.mixture.components, visible, self.motion)
