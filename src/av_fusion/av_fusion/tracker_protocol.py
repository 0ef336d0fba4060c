"""Interface between trackers and the fusion stage."""

from __future__ import annotations

from typing import Protocol

from av_common.track import Track
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import Pose, RigMotion


class Tracker(Protocol):
    """Estimates the bearing of one target. Measurements may arrive late and out of order; times are capture times in s."""

    @property
    def motion(self) -> RigMotion:
        """The rig's attitude and path."""

    def reset(self) -> None:
        """Discard the track, but keep the rig's motion and the result of calibration."""

    def add_pose(self, pose: Pose) -> None:
        """Use attitude and motion of the rig."""

    def add_doa(self, measurement: DoaMeasurement) -> None:
        """Use a direction of arrival; one that is not plausible is ignored."""

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """Use the detections of an image, or their absence."""

    def estimate(self, time: float) -> Track:
        """The track at `time`, which may be later than the newest measurement."""

    def diagnostics(self) -> dict[str, str]:
        """Names and values of internal state for diagnostics, such as the result of self-calibration."""
