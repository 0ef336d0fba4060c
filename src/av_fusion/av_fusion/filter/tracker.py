"""A Bayes filter on the circle that keeps the mirror images of a direction of arrival as components until evidence decides."""

from __future__ import annotations

import math
from math import remainder, tau

from av_common.track import Source, State, Track
from av_fusion.calibration.array_calibration import LEAST_CONFIDENCE, ArraySelfCalibration
from av_fusion.calibration.sighting_history import Sighting, SightingHistory
from av_fusion.disambiguation.rotation import Candidate, RotationPlanner
from av_fusion.filter.coasting import CoastingTrack
from av_fusion.filter.doa_likelihood import mirror_axis
from av_fusion.filter.gaussian_component import GaussianComponent
from av_fusion.filter.outlier_rate import OutlierRateEstimator
from av_fusion.filter.posterior import Posterior, effective_sample_fraction
from av_fusion.filter.settings import BayesSettings
from av_fusion.filter.state_machine import StateMachine
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement, usable_camera, usable_doa
from av_fusion.measurement.rig_motion import RigMotion

SOURCES = {(0.0, 0.0): Source.NOTHING, (1.0, 0.0): Source.SIGHT, (0.0, 1.0): Source.SOUND,
           (1.0, 1.0): Source.SIGHT | Source.SOUND}  # by whether sight and sound are recent
MAX_GAP_S = 5.0  # a longer gap between measurements, or jump of the clock, starts a new track
LEAST_COMPARED_VARIANCE = 1e-5  # of a cosine that is compared with a sighting


class BayesTracker:
    """Tracks one target by a mixture of `GaussianComponent`s and a uniform background for a target elsewhere, or none.

    Directions of arrival enter as a mixture of their mirror images and clutter, images as detections or their absence.
    Measurements may arrive late and in any order: each counts at its own capture time, rotated by the rig's yaw of that
    time. Implements `Tracker`.

    Attributes:
        settings: see `BayesSettings`.
        motion: the rig's yaw over time.
        machine: which sensor leads, and why.
        planner: rotations of the rig that resolve the front-back ambiguity.
        self_calibration: corrects directions of arrival by the camera.

    Parameters:
        settings: see the attribute.
    """

    def __init__(self, settings: BayesSettings | None = None) -> None:
        self.settings = settings or BayesSettings()
        self.motion = RigMotion()
        self.machine = StateMachine(self.settings.machine)
        self.planner = RotationPlanner(self.settings.rotation)
        self.self_calibration = ArraySelfCalibration(self.settings.self_calibration)
        self._outlier_rate = OutlierRateEstimator(self.settings.outlier_rate)
        self._posterior = Posterior(self.settings)
        self._sightings = SightingHistory()
        self._coasting = CoastingTrack(self.settings.coast)
        self._resolved = False
        self._visibility = math.nan
        self._mirror_axis: float | None = None  # body azimuth, of the newest direction of arrival

    def reset(self) -> None:
        """See `Tracker`."""
        self._posterior = Posterior(self.settings)
        self._sightings = SightingHistory()
        self._coasting = CoastingTrack(self.settings.coast)
        self._resolved = False
        self._visibility = math.nan
        self._mirror_axis = None

    def add_pose(self, time: float, yaw: float, yaw_rate: float = 0.0) -> None:
        """See `Tracker`."""
        self.motion.add(time, yaw, yaw_rate)

    def add_doa(self, measurement: DoaMeasurement) -> None:
        """See `Tracker`."""
        usable = usable_doa(measurement)
        if usable is None:
            return
        time = usable.time - self.settings.sound_delay
        yaw = self.motion.yaw(time)
        corrected = self._calibrate(usable, time, yaw)
        self._reset_after_gap(time)
        self._mirror_axis = mirror_axis(corrected.hypotheses, corrected.cone)
        self._posterior.update_doa(time, corrected, yaw, self.motion.yaw_rate(time),
                                   self._outlier_rate.rate(corrected.confidence))
        primary = self._posterior.mixture.primary()
        self.machine.on_doa(time, corrected.confidence, primary is not None and primary.newest_doa >= time)

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """See `Tracker`."""
        usable = usable_camera(measurement)
        if usable is None:
            return
        time = usable.time - self.settings.sight_delay
        yaw, best = self.motion.yaw(time), usable.best
        self._reset_after_gap(time)
        self._visibility = usable.visibility
        if best is not None and best.score >= LEAST_CONFIDENCE:
            self._sightings.add(Sighting(time, remainder(yaw + best.azimuth, tau), best.elevation, best.azimuth_variance))
        self.machine.on_image(time, self._posterior.update_camera(time, usable, yaw))

    def estimate(self, time: float) -> Track:
        """See `Tracker`. The posterior itself is not moved."""
        posterior, machine = self._posterior, self.machine
        primary = posterior.mixture.primary()
        ahead = 0.0 if posterior.time is None else time - posterior.time
        yaw, noise_scale = self.motion.yaw(time), posterior.noise_scale(time)
        if primary is None or posterior.mixture.background >= 0.5 or ahead >= MAX_GAP_S:
            return self._coast(time, yaw, ahead)
        later = posterior.mixture.predicted(primary, ahead, noise_scale)
        if later.azimuth_variance >= self.settings.lost_sigma**2:
            return self._coast(time, yaw, ahead)
        state = machine.step(time, True)
        front = posterior.mixture.front_probability(yaw, ahead, noise_scale)
        share = self._resolve(primary, front, yaw)
        sight = 1.0 if state == State.VISUAL_ACTIVE else 0.0
        sound = 1.0 if time - primary.newest_doa <= machine.settings.sound_timeout else 0.0
        track = Track(
            time=time, state=state, reason=machine.reason, changed=machine.changed, source=SOURCES[sight, sound],
            azimuth=remainder(later.azimuth - yaw, tau), elevation=later.elevation,
            azimuth_variance=later.azimuth_variance,
            elevation_variance=later.elevation_variance if primary.elevation_measured else math.inf,
            azimuth_world=later.azimuth, azimuth_world_rate=later.rate,
            measured=primary.measured, front_probability=front, resolved=self._resolved,
            requested_rotation=self._plan_rotation(time, yaw, share), sound_confidence=machine.sound_confidence,
            sight_confidence=machine.sight_confidence, sound_weight=sound * (1.0 - 0.5 * sight),
            sight_weight=sight * (1.0 - 0.5 * sound), visibility=self._visibility)
        self._coasting.keep(track, later.rate_variance)
        return track

    def diagnostics(self) -> dict[str, str]:
        """See `Tracker`."""
        learned = self.self_calibration.describe() if self.self_calibration.compared else {}
        return {**self.machine.diagnostics(), **{f'array self-calibration: {name}': value for name, value in learned.items()}}

    def _reset_after_gap(self, time: float) -> None:
        if self._posterior.time is not None and abs(time - self._posterior.time) > MAX_GAP_S:
            self.reset()

    def _calibrate(self, measurement: DoaMeasurement, time: float, yaw: float) -> DoaMeasurement:
        """Compare a direction of arrival with the sighting of its time; returns it corrected by all comparisons so far."""
        seen, cone = self._sightings.at(time), measurement.cone
        azimuth = 0.0 if seen is None else remainder(seen.azimuth - yaw, tau)
        if self.settings.self_calibration.enabled:
            if cone is not None and seen is not None and measurement.confidence >= LEAST_CONFIDENCE:
                fraction = effective_sample_fraction(time, self._posterior.newest_doa, measurement.window)
                variance = cone.variance + self.settings.sound_floor_sigma**2 * cone.slope_squared
                self.self_calibration.compare(time, cone.cosine, remainder(azimuth - cone.axis, tau), seen.elevation,
                                              max(variance, LEAST_COMPARED_VARIANCE) / fraction, seen.variance)
            measurement = self.self_calibration.corrected(measurement)
        if seen is not None:
            self._outlier_rate.compare(measurement, time, azimuth)
        return measurement

    def _coast(self, time: float, yaw: float, ahead: float) -> Track:
        """The last supported track, predicted; else none."""
        machine, predicted = self.machine, None
        if ahead < MAX_GAP_S:
            density = self._posterior.noise_scale(time) * self.settings.acceleration_density
            predicted = self._coasting.predicted(time, yaw, density)
        state = machine.step(time, False, predicted is not None)
        self._resolved = False
        self.planner.cancel()
        return (predicted or Track(time))._replace(
            state=state, reason=machine.reason, changed=machine.changed, sound_confidence=machine.sound_confidence,
            sight_confidence=machine.sight_confidence, visibility=self._visibility)

    def _resolve(self, primary: GaussianComponent, front: float, yaw: float) -> float:
        """Decide whether the ambiguity is resolved; the probability of the primary component's direction."""
        axis = math.nan if self._mirror_axis is None else yaw + self._mirror_axis
        share = self._posterior.mixture.share_of(primary, axis)
        confirmed = min(share, max(front, 1.0 - front)) >= self.settings.confirm_threshold
        kept = self._resolved and share >= self.settings.release_threshold
        self._resolved = confirmed or self._mirror_axis is None or kept
        return share

    def _plan_rotation(self, time: float, yaw: float, share: float) -> float:
        axis = self._mirror_axis
        if self._resolved or axis is None:
            self.planner.cancel()
            return 0.0
        return self.planner.plan(time, yaw, lambda: self._candidates(yaw, share, axis), axis, self._visibility)

    def _candidates(self, yaw: float, share: float, axis: float) -> list[Candidate]:
        """Possible directions of the target, seen from the rig at `yaw`."""
        candidates = [Candidate(remainder(c.azimuth - yaw, tau), c.azimuth_variance, c.rate, c.rate_variance, c.weight)
                      for c in self._posterior.mixture.components]
        if share < self.settings.confirm_threshold:
            return candidates
        first = max(candidates, key=lambda candidate: candidate.weight)  # one direction close to the axis: either side
        return [first, first._replace(azimuth=remainder(2.0 * axis - first.azimuth, tau), rate=-first.rate)]
