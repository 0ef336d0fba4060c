"""Settings of the Bayes filter."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from av_common.rig import GimbalMount
from av_fusion.calibration.array_calibration import SelfCalibrationSettings
from av_fusion.disambiguation.rotation import RotationSettings
from av_fusion.filter.motion_model import MotionModel
from av_fusion.filter.state_machine import MachineSettings


@dataclass(frozen=True)
class BayesSettings:
    """Models of targets and sensors.

    Parameters:
        acceleration_density (rad^2/s^3): spectral density of the angular acceleration.
        elevation_density (rad^2/s): diffusion of the elevation around its mean.
        usual_elevation, usual_elevation_sigma (rad): mean and stationary standard deviation of the elevation.
        rate_sigma (rad/s): prior standard deviation of the angular rate.
        loss_rate (1/s): rate at which the target disappears and another one appears anywhere.
        sound_floor_sigma (rad): error of directions of arrival beyond what they report.
        outlier_rate: prior share of directions of arrival that do not stem from the target; 0 disables outliers.
        detection_probability: probability that a visible target in view is detected.
        sight_correlation (s): correlation time of the errors of successive images.
        lost_sigma (rad): a track of larger standard deviation ends.
        coast (s): longest prediction of a track that measurements no longer support.
        confirm_threshold: probability from which the front-back ambiguity counts as resolved.
        release_threshold: probability below which it counts as unresolved again.
        assumed_visibility: visibility (0..1) of images without one.
        gimbal: the gimbal that carries the camera, which then looks where the target is heard; None for a fixed camera.
        sound_delay, sight_delay (s): delay of the stamps of directions of arrival and of images.
        machine, rotation, self_calibration: settings of the parts.
    """

    acceleration_density: float = 0.02
    elevation_density: float = 0.001
    usual_elevation: float = math.radians(10.0)
    usual_elevation_sigma: float = math.radians(10.0)
    rate_sigma: float = 0.3
    loss_rate: float = 0.002
    sound_floor_sigma: float = math.radians(0.5)
    outlier_rate: float = 0.01
    detection_probability: float = 0.9
    sight_correlation: float = 0.3
    lost_sigma: float = math.radians(30.0)
    coast: float = 3.0
    confirm_threshold: float = 0.95
    release_threshold: float = 0.8
    assumed_visibility: float = 0.0
    gimbal: GimbalMount | None = None
    sound_delay: float = 0.0
    sight_delay: float = 0.0
    machine: MachineSettings = field(default_factory=MachineSettings)
    rotation: RotationSettings = field(default_factory=RotationSettings)
    self_calibration: SelfCalibrationSettings = field(default_factory=SelfCalibrationSettings)

    @property
    def model(self) -> MotionModel:
        """Motion of targets."""
        return MotionModel(self.acceleration_density, self.elevation_density, self.usual_elevation,
                           self.usual_elevation_sigma**2)
