"""Interface between trackers and the fusion stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from av_common.track import Targets, Track
from av_fusion.disambiguation.rotation import RotationPlanner
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.measurement.vectors import Vector
from av_fusion.tracks.track import Track as FilterTrack


class Tracker(Protocol):
    """Estimates the bearing of a target: of the one that is followed where there are several.

    Measurements are plausible (`usable_doas`, `usable_camera`); they may arrive late and out of order. Times are capture times
    in s.
    """

    @property
    def motion(self) -> RigMotion:
        """The rig's attitude and path."""

    @property
    def planner(self) -> RotationPlanner:
        """Plans rotations of the rig that resolve the front-back ambiguity."""

    def reset(self) -> None:
        """Discard the track and all times, but keep the rig's motion and the result of calibration."""

    def add_pose(self, pose: Pose) -> None:
        """Use attitude and motion of the rig."""

    def add_doas(self, measurements: Sequence[DoaMeasurement]) -> None:
        """Use the directions of arrival of one window, of different sources."""

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """Use the detections of an image, or their absence."""

    def use_cue(self, cue: Vector, variance: float, wrong: float) -> None:
        """Decide between mirror images by where others say that a target is.

        Parameters:
            cue: unit vector in the world.
            variance (rad^2): of its direction along each axis.
            wrong: probability that it concerns another target.
        """

    def estimate(self, time: float) -> Track:
        """The track at `time`, which may be later than the newest measurement."""

    def targets(self, track: Track) -> Targets:
        """All targets at the time of the newest estimate, `track`."""

    def densities(self) -> Sequence[FilterTrack]:
        """The density of each target that may exist; empty for a tracker without one."""

    def select(self, identifier: int) -> None:
        """Follow the target with this id as long as it is tracked; 0: follow the one of the policy.

        Raises ValueError where no such target is tracked.
        """

    def tune(self, tau: float, confirm_threshold: float) -> None:
        """Use other thresholds from now on; a tracker without such a decision ignores its threshold.

        Parameters:
            tau: score of a detection from which the camera leads.
            confirm_threshold: probability from which the front-back ambiguity counts as resolved.
        """

    def forget_emitters(self) -> int:
        """Forget which targets are fixed emitters; returns how many were."""

    def diagnostics(self) -> dict[str, str]:
        """Names and values of internal state for diagnostics, such as the result of self-calibration."""
