"""The rate of outliers among directions of arrival is learned from detections."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated_sensors import SimulatedSensors

from av_fusion.filter.outlier_rate import OutlierRateEstimator
from av_fusion.measurement.vectors import direction


def learned(share_wrong, seconds=40.0, seed=1):
    """Rate learned when in a share of the seconds directions are 60 degrees off."""
    random, sensors, estimator = np.random.default_rng(seed), SimulatedSensors(seed), OutlierRateEstimator(0.01)
    for second in range(int(seconds)):
        off = math.radians(60.0) if random.random() < share_wrong else 0.0
        for step in range(10):
            time = 100.0 + second + 0.1 * step
            estimator.compare(sensors.doa(time, 0.2 + off), time, direction(0.2))
    return estimator.rate(1.0)


@pytest.mark.parametrize('share_wrong', [0.0, 0.3, 0.9])
def test_the_share_is_found(share_wrong):
    """Within what 40 draws of it allow, two standard deviations, and the prior's pull."""
    assert abs(learned(share_wrong) - share_wrong) < 0.05 + 2.0 * math.sqrt(share_wrong * (1.0 - share_wrong) / 40.0)


def test_the_mirror_image_is_no_disagreement():
    """Directions of the image behind a target seen in front are no outliers."""
    estimator, sensors = OutlierRateEstimator(0.01), SimulatedSensors(2)
    for step in range(200):
        estimator.compare(sensors.doa(0.1 * step, math.pi - 0.3), 0.1 * step, direction(0.3))
    assert estimator.rate(1.0) < 0.02


def test_unsure_sounds_are_estimatored_less_and_zero_switches_it_off():
    """Confident directions stem from the target; with a prior of zero there are no outliers."""
    assert OutlierRateEstimator(0.01).rate(0.95) < 0.02 < 0.5 < OutlierRateEstimator(0.01).rate(0.2)
    estimator, sensors = OutlierRateEstimator(0.0), SimulatedSensors(3)
    for step in range(100):
        estimator.compare(sensors.doa(0.1 * step, 1.5), 0.1 * step, direction(0.0))
    assert estimator.rate(0.2) == 0.0
