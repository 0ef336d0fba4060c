"""A rig with a target, in closed form: what two microphones and a camera would report, with Gaussian errors."""

from __future__ import annotations

import math

import numpy as np

from av_common.angles import wrap
from av_fusion.measurement.measurements import LEAST_SINE, CameraMeasurement, Cone, Detection, DoaMeasurement

LEFT = (0.0, 1.0, 0.0)


class SimulatedSensors:
    """Draws measurements of a target at a body azimuth; seeded."""

    def __init__(self, seed: int = 0, sound_sigma: float = math.radians(1.5), sight_sigma: float = math.radians(0.4)) -> None:
        self.random = np.random.default_rng(abs(seed))
        self.sound_sigma, self.sight_sigma = sound_sigma, sight_sigma

    def doa(self, time: float, azimuth: float, confidence: float = 0.9) -> DoaMeasurement:
        """Two mirror images (front and back of a left-right pair), sigma growing as 1/|cos(azimuth)|."""
        sigma = self.sound_sigma / max(abs(math.cos(azimuth)), 0.1)
        measured = float(wrap(azimuth + self.random.normal(0.0, sigma)))
        slope = max(abs(math.cos(measured)), LEAST_SINE)
        return DoaMeasurement.of_cone(time, Cone(LEFT, math.sin(measured), (slope * sigma) ** 2), confidence)

    def camera(self, time: float, azimuth: float, visibility: float = 1.0, half_view: float = 0.6,
             detection_probability: float = 0.9) -> CameraMeasurement:
        """An image that shows the target when it is in view and `visibility * recall` allows."""
        seen = abs(wrap(azimuth)) < half_view and self.random.random() < visibility * detection_probability
        measured = float(wrap(azimuth + self.random.normal(0.0, self.sight_sigma)))
        found = (Detection(measured, self.sight_sigma**2, 0.9, 0.1, 0.01),) if seen else ()
        return CameraMeasurement(time, found, half_view, visibility=visibility)
