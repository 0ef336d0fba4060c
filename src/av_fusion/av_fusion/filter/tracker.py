"""A Bayes filter on the sphere that keeps the mirror images of a direction of arrival as components until evidence decides."""

from __future__ import annotations

import math
from math import remainder, tau

from av_common.track import Source, State, Track
from av_fusion.calibration.array_calibration import LEAST_CONFIDENCE, ArraySelfCalibration
from av_fusion.calibration.sighting_history import Sighting, SightingHistory
from av_fusion.disambiguation.rotation import Candidate, RotationPlanner, Tilt
from av_fusion.filter.camera_looks import CameraLooks
from av_fusion.filter.coasting import CoastingTrack
from av_fusion.filter.doa_likelihood import mirror_axis
from av_fusion.filter.gaussian_component import GaussianComponent
from av_fusion.filter.outlier_rate import OutlierRateEstimator
from av_fusion.filter.posterior import Posterior
from av_fusion.filter.settings import BayesSettings
from av_fusion.filter.state_machine import StateMachine
from av_fusion.filter.target_density import effective_sample_fraction
from av_fusion.filter.world_track import placed
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement, usable_camera, usable_doa
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.measurement.vectors import Rows, Vector, angles, cross, direction, dot, turned, turned_back

SOURCES = {(0.0, 0.0): Source.NOTHING, (1.0, 0.0): Source.SIGHT, (0.0, 1.0): Source.SOUND,
           (1.0, 1.0): Source.SIGHT | Source.SOUND}  # by whether sight and sound are recent
UNKNOWN = 0.5  # visibility that is taken for a look while it is unknown: only looking tells
MAX_GAP_S = 5.0  # a longer gap between measurements, or jump of the clock, starts a new track
OVERHEAD = math.sin(math.radians(60.0))  # vertical part of a direction in the body, above which front and back do not matter
LEAST_TARGET_PROBABILITY = 0.1  # a direction of arrival that is less likely the target's is a bystander's and not followed
LEAST_COMPARED_VARIANCE = 1e-5  # of a cosine that is compared with a sighting


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
        self_calibration: corrects directions of arrival by the camera.
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
        self.self_calibration = ArraySelfCalibration(self.settings.self_calibration)
        self._outlier_rate = OutlierRateEstimator(self.settings.outlier_rate)
        self._posterior = Posterior(self.settings, self.motion)
        self._sightings = SightingHistory()
        self._coasting = CoastingTrack(self.settings.coast, self.settings.model)
        self.bystander: DoaMeasurement | None = None
        self._resolved = False
        self._visibility = math.nan
        self._mirror_axis: Vector | None = None  # in the body frame, of the newest direction of arrival

    def reset(self) -> None:
        """See `Tracker`."""
        self._posterior = Posterior(self.settings, self.motion)
        self._sightings = SightingHistory()
        self._coasting = CoastingTrack(self.settings.coast, self.settings.model)
        self._resolved = False
        self._visibility = math.nan
        self._mirror_axis = None

    def add_pose(self, pose: Pose) -> None:
        """See `Tracker`. Where the attitude jumps, the track keeps its direction in the body: that was measured."""
        jump = self.motion.add(pose)
        if jump is not None:
            self._posterior.mixture.turn_world(jump)
            self._sightings.turn_world(jump)
            self._coasting.turn_world(jump)

    def add_doa(self, measurement: DoaMeasurement) -> None:
        """See `Tracker`."""
        usable = usable_doa(measurement)
        if usable is None:
            return
        if usable.target_probability < LEAST_TARGET_PROBABILITY:
            self.bystander = usable
            return
        usable = usable._replace(confidence=usable.confidence * usable.target_probability)
        time = usable.time - self.settings.sound_delay
        corrected = self._calibrate(usable, time)
        self._reset_after_gap(time)
        self._mirror_axis = mirror_axis(corrected.hypotheses, corrected.cone)
        self._posterior.update_doa(time, corrected, self._outlier_rate.rate(corrected.confidence))
        primary = self._posterior.mixture.primary()
        self.machine.on_doa(time, corrected.confidence, primary is not None and primary.newest_doa >= time)

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """See `Tracker`."""
        usable = usable_camera(measurement)
        if usable is None:
            return
        time, best = usable.time - self.settings.sight_delay, usable.best
        self._reset_after_gap(time)
        self._visibility = usable.visibility
        if best is not None and best.score >= LEAST_CONFIDENCE:
            seen = turned(self.motion.attitude(time), direction(best.azimuth, best.elevation))
            self._sightings.add(Sighting(time, seen, best.across_variance))
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
        share = self._resolve(primary, front, attitude)
        sight = 1.0 if state == State.VISUAL_ACTIVE else 0.0
        sound = 1.0 if time - primary.newest_doa <= machine.settings.sound_timeout else 0.0
        track = placed(Track(
            time=time, state=state, reason=machine.reason, changed=machine.changed, source=SOURCES[sight, sound],
            measured=primary.measured, front_probability=front, resolved=self._resolved,
            requested_rotation=self._plan_rotation(time, attitude, share), look=self._plan_look(time, state),
            sound_confidence=machine.sound_confidence,
            sight_confidence=machine.sight_confidence, sound_weight=sound * (1.0 - 0.5 * sight),
            sight_weight=sight * (1.0 - 0.5 * sound), visibility=self._visibility), later.with_variance(
                posterior.variance_scale(time, sight > 0.0), self._heard_axis(attitude) if sight == 0.0 else None), self.motion)
        self._coasting.keep(track, later)
        return track

    def diagnostics(self) -> dict[str, str]:
        """See `Tracker`."""
        found = self.machine.diagnostics()
        if self.bystander is not None:
            azimuths = ' or '.join(f'{math.degrees(h.azimuth):.0f}' for h in self.bystander.hypotheses)
            found['newest bystander'] = f'at {self.bystander.time:.1f} s, azimuth {azimuths} deg'
        learned = self.self_calibration.describe() if self.self_calibration.compared else {}
        return {**found, **{f'array self-calibration: {name}': value for name, value in learned.items()}}

    def _reset_after_gap(self, time: float) -> None:
        if self._posterior.time is not None and abs(time - self._posterior.time) > MAX_GAP_S:
            self.reset()

    def _calibrate(self, measurement: DoaMeasurement, time: float) -> DoaMeasurement:
        """Compare a direction of arrival with the sighting of its time; returns it corrected by all comparisons so far."""
        sighting, cone = self._sightings.at(time), measurement.cone
        seen = None if sighting is None else turned_back(self.motion.attitude(time), sighting.direction)
        if self.settings.self_calibration.enabled:
            if cone is not None and sighting is not None and seen is not None and measurement.confidence >= LEAST_CONFIDENCE:
                fraction = effective_sample_fraction(time, self._posterior.newest_doa, measurement.window)
                variance = cone.variance + self.settings.sound_floor_sigma**2 * cone.slope_squared
                azimuth, elevation = from_axis(cone.axis, seen)
                self.self_calibration.compare(time, cone.cosine, azimuth, elevation,
                                              max(variance, LEAST_COMPARED_VARIANCE) / fraction, sighting.variance)
            measurement = self.self_calibration.corrected(measurement)
        if seen is not None:
            self._outlier_rate.compare(measurement, time, seen)
        return measurement

    def _coast(self, time: float, ahead: float) -> Track:
        """The last supported track, predicted; else none."""
        machine, predicted = self.machine, None
        if ahead < MAX_GAP_S:
            predicted = self._coasting.predicted(time, self.motion, self._posterior.noise_scale(time))
        state = machine.step(time, False, predicted is not None)
        self._resolved = False
        self.planner.cancel()
        return (predicted or Track(time, attitude_known=self.motion.is_known(time)))._replace(
            state=state, reason=machine.reason, changed=machine.changed, sound_confidence=machine.sound_confidence,
            sight_confidence=machine.sight_confidence, visibility=self._visibility)

    def _heard_axis(self, attitude: Rows) -> Vector | None:
        """Axis in the world of the cone that the array measures; None for other arrays."""
        return None if self._mirror_axis is None else turned(attitude, self._mirror_axis)

    def _resolve(self, primary: GaussianComponent, front: float, attitude: Rows) -> float:
        """Decide whether the ambiguity is resolved; the probability of the primary component's direction."""
        axis = self._heard_axis(attitude)
        share = self._posterior.mixture.share_of(primary, axis)
        overhead = abs(dot(primary.direction, (attitude[0][2], attitude[1][2], attitude[2][2]))) > OVERHEAD
        hemisphere = 1.0 if overhead else max(front, 1.0 - front)
        confirmed = min(share, hemisphere) >= self.settings.confirm_threshold
        kept = self._resolved and share >= self.settings.release_threshold
        self._resolved = confirmed or self._mirror_axis is None or kept
        return share

    def _plan_rotation(self, time: float, attitude: Rows, share: float) -> float:
        axis = self._mirror_axis
        if self._resolved or axis is None:
            self.planner.cancel()
            return 0.0
        yaw = self.motion.yaw(time)
        tilt = Tilt.of(attitude, yaw, self.motion.rate(time), axis)
        return self.planner.plan(time, yaw, lambda: self._candidates(yaw, share, tilt.axis), tilt, self._visibility)

    def _plan_look(self, time: float, state: State) -> tuple[float, float] | None:
        if self.looks is None:
            return None
        if state == State.VISUAL_ACTIVE:
            self.looks.planner.cancel()
            return None
        visibility = self._visibility if math.isfinite(self._visibility) else max(self.settings.assumed_visibility, UNKNOWN)
        visible = visibility * self.settings.detection_probability
        return self.looks.plan(time, self._posterior.mixture.components, visible, self.motion)

    def _candidates(self, yaw: float, share: float, axis: Vector) -> list[Candidate]:
        """Possible directions of the target, level and seen from the rig's heading; `axis` is that of the array."""
        candidates = []
        for c in self._posterior.mixture.components:
            (across, _), (_, up) = c.covariance[:2, :2].tolist()
            candidates.append(Candidate(remainder(c.azimuth - yaw, tau), across, c.across_rate, float(c.covariance[2, 2]),
                                        c.weight, c.elevation, up))
        if share < self.settings.confirm_threshold:
            return candidates
        first = max(candidates, key=lambda candidate: candidate.weight)  # one direction close to the axis: either side
        mirrored = remainder(2.0 * math.atan2(axis[1], axis[0]) - first.azimuth, tau)
        return [first, first._replace(azimuth=mirrored, rate=-first.rate)]


def from_axis(axis: Vector, seen: Vector) -> tuple[float, float]:
    """Azimuth and elevation (rad) of a direction in a frame whose x axis is `axis` and whose y axis is level in the body."""
    level = max(math.hypot(axis[0], axis[1]), 1e-9)
    left = (-axis[1] / level, axis[0] / level, 0.0)
    return angles((dot(axis, seen), dot(left, seen), dot(cross(axis, left), seen)))
