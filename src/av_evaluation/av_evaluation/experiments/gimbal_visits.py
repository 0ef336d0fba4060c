"""A camera on a gimbal that follows one target, or visits several in turn, on simulated measurements."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from av_common.angles import angles_to_direction
from av_common.gimbal_geometry import gimbal_to_body
from av_common.rig import GimbalMount
from av_evaluation.experiments.measurement_simulation import MeasurementSimulation, Scan
from av_fusion.measurement.rig_motion import Pose
from av_fusion.tracker import MultiTargetTracker, TrackerSettings
from av_pointing.controller import Ages, PointingController, PointingSettings
from av_pointing.settings import with_gimbal

STEP_S = 0.02  # between commands
NO_DELAY = Ages(0.0, 0.0, 0.0)


class GimbalRig:
    """Tracker and pointing of a rig that stands still; the gimbal's camera takes the images. A `Peer`.

    Parameters:
        simulation: of the measurements, whose camera is turned.
        visits: whether several targets are visited; else the followed one is looked at.
        gimbal: carries the camera.
    """

    def __init__(self, simulation: MeasurementSimulation, visits: bool, gimbal: GimbalMount | None = None) -> None:
        self._simulation, self._gimbal, self._time = simulation, gimbal or GimbalMount(), 0.0
        self.tracker = MultiTargetTracker(TrackerSettings(gimbal=self._gimbal, visits=visits))
        self.controller = PointingController(with_gimbal(PointingSettings(move_body=False), self._gimbal))

    def use(self, scan: Scan) -> dict[int, NDArray[np.float64]]:
        """See `Peer`."""
        tracker = self.tracker
        tracker.add_pose(Pose.level(scan.time, 0.0))
        if scan.doas is not None:
            tracker.add_doas(scan.doas)
        if scan.image is not None:
            tracker.add_camera(scan.image)
        track = tracker.estimate(scan.time)
        while self._time < scan.time:
            self._time += STEP_S
            command = self.controller.step(self._time, track, NO_DELAY)
        if scan.time > 0.0:
            self._simulation.camera = gimbal_to_body(self._gimbal, command.pan, command.tilt)
        return {target.id: angles_to_direction(target.track.azimuth, target.track.elevation)
                for target in tracker.targets(track).targets if not target.drone_probability < 0.5}

    def identity(self) -> float:
        """See `Peer`."""
        return min((track.identity for track in self.tracker.filter.tracks), default=math.nan)
