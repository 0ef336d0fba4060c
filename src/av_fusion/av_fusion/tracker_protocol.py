"""Interface between trackers and the fusion stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from av_common.track import Targets, Track
from av_fusion.disambiguation.rotation import RotationPlanner
from av_fusion.filter.target_density import TargetDensity
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.measurement.vectors import Rows


class Tracker(Protocol):
    """Estimates the bearing of a target: of the one that is followed where there are several.

    Measurements may arrive late and out of order; times are capture times in s.
    """

    @property
    def motion(self) -> RigMotion:
        """The rig's attitude and path."""

    @property
    def planner(self) -> RotationPlanner:
        """Plans rotations of the rig that resolve the front-back ambiguity."""

    def reset(self) -> None:
        """Discard the track, but keep the rig's motion and the result of calibration."""

    def add_pose(self, pose: Pose) -> Rows | None:
        """Use attitude and motion of the rig; returns the rotation of the world where the attitude jumped, else None."""

    def add_doas(self, measurements: Sequence[DoaMeasurement]) -> None:
        """Use the directions of arrival of one window, of different sources; those that are not plausible are ignored."""

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """Use the detections of an image, or their absence."""

    def expected_doas(self, measurements: Sequence[DoaMeasurement]) -> list[DoaMeasurement]:
        """Those of the directions of arrival of one window that lie in the gate of a track."""

    def expected_image(self, measurement: CameraMeasurement) -> CameraMeasurement | None:
        """The image with those of its detections that lie in the gate of a track; None without any."""

    def estimate(self, time: float) -> Track:
        """The track at `time`, which may be later than the newest measurement."""

    def targets(self, track: Track) -> Targets:
        """All targets at the time of the newest estimate, `track`."""

    def densities(self) -> Sequence[TargetDensity]:
        """The posterior of each target that may exist; empty for a tracker without one."""

    def select(self, identifier: int) -> None:
        """Follow the target with this id as long as it is tracked; 0: follow the one of the policy.

        Raises ValueError where no such target is tracked.
        """

    def diagnostics(self) -> dict[str, str]:
        """Names and values of internal state for diagnostics, such as the result of self-calibration."""
