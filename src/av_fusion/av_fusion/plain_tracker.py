"""The base of a tracker of one target that knows nothing but azimuths and their variances."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

from av_common.angles import wrap
from av_common.track import Source, State, Target, Targets, Track
from av_fusion.disambiguation.rotation import RotationPlanner
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import Pose, RigMotion

FORGET_S = 3.0  # longest prediction of a track that no measurement supports


class PlainTracker:
    """The interface of trackers, for one target; a subclass says what a measurement changes, and where the target is.

    Measurements are plausible (`usable_doas`, `usable_camera`); they may arrive late and out of order. Times are capture times
    in s. Of mirror images it takes the one nearest to where the target is, or in front of the rig. Detections below `tau` are
    not used.

    Attributes:
        FOLDED: whether the tracker leaves it to others to tell front from back: in evaluations it is given the true one.
        motion: the rig's attitude and path.
        planner: requests no rotation.
        tau: least score of a detection.

    Parameters:
        parameters: those of fusion_node; None for defaults.
        gimbal: carries the camera; not used.
    """

    FOLDED: ClassVar[bool] = True

    def __init__(self, parameters: Any = None, gimbal: object = None) -> None:
        self.motion, self.planner = RigMotion(), RotationPlanner(enabled=False)
        self.tau = 0.5 if parameters is None else float(parameters.tau)
        self._sound_delay = 0.0 if parameters is None else float(parameters.sound_delay)
        self._sight_delay = 0.0 if parameters is None else float(parameters.sight_delay)
        self._newest = {Source.SOUND: -math.inf, Source.SIGHT: -math.inf}
        self._id, self._tracked = 0, False
        self.restart()

    def restart(self) -> None:
        """Forget the target."""

    def update(self, time: float, azimuth: float, variance: float, source: Source) -> None:
        """Use one measurement.

        Parameters:
            time (s): capture time; may be before that of the last one.
            azimuth (rad), variance (rad^2): direction in the world, counter-clockwise from east.
            source: SOUND or SIGHT.
        """
        raise NotImplementedError

    def predict(self, time: float) -> tuple[float, float] | None:
        """Azimuth (rad, world) and its variance (rad^2) at `time` (s); None while unknown."""
        raise NotImplementedError

    def reset(self, learned: bool = False) -> None:
        """Discard the track and all times, but keep the rig's motion.

        Parameters:
            learned: whether to discard the results of calibration, too.
        """
        self._newest = dict.fromkeys(self._newest, -math.inf)
        self.restart()

    def add_pose(self, pose: Pose) -> None:
        """Use attitude and motion of the rig."""
        self.motion.add(pose)

    def add_doas(self, measurements: Sequence[DoaMeasurement]) -> None:
        """Use the directions of arrival of one window, of different sources: that of the strongest, which is the first."""
        for measurement in measurements[:1]:
            time = measurement.time - self._sound_delay
            yaw, known = self.motion.yaw(time), self.predict(time)
            expected = 0.0 if known is None else known[0] - yaw
            nearest = min(measurement.hypotheses, key=lambda one: abs(wrap(one.azimuth - expected)))
            self._use(time, nearest.azimuth + yaw, nearest.across_variance, Source.SOUND)

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """Use the detections of an image, or their absence."""
        time, best = measurement.time - self._sight_delay, measurement.best
        if best is not None and best.score >= self.tau:
            self._use(time, best.azimuth + self.motion.yaw(time), best.across_variance, Source.SIGHT)

    def _use(self, time: float, azimuth: float, variance: float, source: Source) -> None:
        self._newest[source] = max(self._newest[source], time)
        self.update(time, float(wrap(azimuth)), variance, source)

    def estimate(self, time: float) -> Track:
        """The track at `time` (s), which may be later than the newest measurement."""
        heard, seen = (time - self._newest[source] for source in (Source.SOUND, Source.SIGHT))
        known = self.predict(time) if min(heard, seen) <= FORGET_S else None
        if known is None:
            return Track(time)
        azimuth, variance = known
        sight, recent = seen <= heard, min(heard, seen) <= 1.0
        state = State.COASTING if not recent else State.VISUAL_ACTIVE if sight else State.ACOUSTIC_ACTIVE
        body = float(wrap(azimuth - self.motion.yaw(time)))
        leading = Source.SIGHT if sight else Source.SOUND
        return Track(
            time, state, 'sight' if sight else 'sound', source=leading if recent else Source.NOTHING,
            azimuth=body, azimuth_variance=variance, azimuth_world=azimuth, covariance_world=(variance, 0.0, 0.0, math.inf),
            attitude_known=self.motion.is_known(time), measured=max(self._newest.values()),
            front_probability=0.95 if math.cos(body) > 0.0 else 0.05, sound_weight=float(not sight), sight_weight=float(sight))

    def targets(self, track: Track) -> Targets:
        """All targets at the time of the newest estimate, `track`."""
        tracked = track.state != State.NONE
        self._id, self._tracked = self._id + (tracked and not self._tracked), tracked
        if not tracked:
            return Targets(track.time)
        heard, seen = self._newest[Source.SOUND], self._newest[Source.SIGHT]
        return Targets(track.time, (Target(self._id, 1.0, track, heard=heard, seen=seen),), self._id)

    def select(self, identifier: int) -> None:
        """Follow the target with this id as long as it is tracked; 0: follow the one of the policy.

        Raises ValueError where no such target is tracked.
        """
        if identifier not in (0, self._id if self._tracked else 0):
            raise ValueError(f'target {identifier} is not tracked')

    def use_cue(self, cue: Any, variance: float, wrong: float) -> None:
        """Decide between mirror images by where others say that a target is; not used here.

        Parameters:
            cue: unit vector in the world.
            variance (rad^2): of its direction along each axis.
            wrong: probability that it concerns another target.
        """

    def tune(self, tau: float, confirm_threshold: float) -> None:
        """Use other thresholds from now on; a tracker without such a decision ignores its threshold.

        Parameters:
            tau: score of a detection from which the camera leads.
            confirm_threshold: probability from which the front-back ambiguity counts as resolved.
        """
        self.tau = tau

    def forget_emitters(self) -> int:
        """Forget which targets are fixed emitters; returns how many were: none are known here."""
        return 0

    def densities(self) -> list[Any]:
        """The density of each target that may exist; empty for a tracker without one."""
        return []

    def diagnostics(self) -> dict[str, str]:
        """Names and values of internal state for diagnostics, such as the result of self-calibration."""
        return {}
