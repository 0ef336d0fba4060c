"""The mixture against the same posterior by brute force: a histogram over azimuth and rate, which approximates nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated_sensors import SimulatedSensors

from av_common.angles import wrap
from av_fusion.measurement.rig_motion import Pose
from av_fusion.tracker import MultiTargetTracker, TrackerSettings
from av_fusion.tracks.component import PASSING_S
from av_fusion.tracks.motion import Elevation, MotionModel
from av_fusion.tracks.settings import FilterSettings

AZIMUTHS = np.radians(np.arange(-180.0, 180.0, 0.5))
RATES = np.radians(np.arange(-80.0, 81.0, 2.0))
DT, SUBSTEPS = 0.5, 10  # windows that follow one another without overlap: every sound is new evidence
DENSITY = 0.02  # rad^2/s^3
LEVEL = MotionModel(1e-8, (Elevation(0.0, math.radians(0.3) ** 2, 1.0),), np.array([DENSITY]), np.ones(1),
                    climb_rates=np.array([5e-5]))
SETTINGS = FilterSettings(LEVEL, loss_rate=0.0, sound_floor_sigma=0.0, unheard_rate=0.0, sound_detection_probability=0.99)


class Histogram:
    """Point masses (azimuth, rate): exact shifts by Fourier's theorem, and a kernel for the white acceleration."""

    def __init__(self) -> None:
        self.mass = np.exp(-0.5 * (RATES / SETTINGS.rate_sigma) ** 2) * np.ones((len(AZIMUTHS), 1))
        density = DENSITY + PASSING_S * np.minimum(RATES**2, 0.5) ** 2
        self._kick = np.exp(-0.5 * (RATES[:, None] - RATES) ** 2 / (density[:, None] * DT / SUBSTEPS))
        self._kick /= self._kick.sum(axis=1, keepdims=True)
        frequencies = 1j * np.fft.fftfreq(len(AZIMUTHS), 1.0 / len(AZIMUTHS))[:, None]
        self._drift = np.exp(-frequencies * RATES * DT / SUBSTEPS)

    def predict(self) -> None:
        for _ in range(SUBSTEPS):
            self.mass = np.fft.ifft(np.fft.fft(self.mass @ self._kick, axis=0) * self._drift, axis=0).real.clip(0.0)

    def doa(self, yaw: float, measurement) -> None:
        azimuth, variance = measurement.hypotheses[0].azimuth, measurement.hypotheses[0].across_variance
        angle = azimuth - 0.5 * math.pi  # from the axis, which is the rig's left
        noise = variance * math.sin(angle) ** 2
        peak = 0.5 * measurement.confidence * 2.0 * math.pi / math.sqrt(2.0 * math.pi * variance)
        misfit = math.cos(angle) - np.cos(AZIMUTHS - yaw - 0.5 * math.pi)
        self.mass *= (1.0 - measurement.confidence + peak * np.exp(-0.5 * misfit**2 / noise))[:, None]
        self.mass /= self.mass.sum()

    def front(self, yaw: float) -> float:
        return float(self.mass[np.cos(AZIMUTHS - yaw) > 0.0].sum())

    def around(self, azimuth: float) -> tuple[float, float]:
        """Mean and sigma of what lies within 25 degrees of an azimuth: the rest is another mode, or clutter."""
        offset = wrap(AZIMUTHS - azimuth)
        mass = np.where(np.abs(offset) < math.radians(25.0), self.mass.sum(axis=1), 0.0)
        mass /= mass.sum()
        mean = float(np.sum(mass * offset))
        return azimuth + mean, math.sqrt(float(np.sum(mass * (offset - mean) ** 2)))


@pytest.mark.parametrize('start_deg', [20.0, 150.0, -130.0, -40.0])
def test_mixture_is_the_posterior(start_deg):
    """While the rig turns at 15 deg/s: front and back within 0.15, mean within 0.3 of sigma, sigma within a quarter."""
    tracker = MultiTargetTracker(TrackerSettings(SETTINGS, rotation=False))
    histogram, sensors = Histogram(), SimulatedSensors(int(abs(start_deg)), math.radians(2.0))
    compared = 0
    for step in range(16):
        t, yaw = step * DT, math.radians(15.0) * step * DT
        truth = math.radians(start_deg) + math.radians(5.0) * t
        measurement = sensors.doa(100.0 + t, float(wrap(truth - yaw)))
        tracker.add_pose(Pose.level(100.0 + t, yaw))
        tracker.add_doas([measurement])
        if step:
            histogram.predict()
        histogram.doa(yaw, measurement)
        track = tracker.estimate(100.0 + t)
        if step < 2 or abs(math.cos(truth - yaw)) < 0.5:
            continue  # within 30 degrees of end-fire the posterior is no sum of few Gaussians
        mean, sigma = histogram.around(track.azimuth_world)
        assert abs(track.front_probability - histogram.front(yaw)) < 0.15
        assert abs(wrap(track.azimuth_world - mean)) < 0.3 * sigma
        assert 0.8 < math.sqrt(track.azimuth_variance) / sigma < 1.25
        compared += 1
    assert compared >= 3
