"""How far what is heard is the target is learnt from what is seen."""

from __future__ import annotations

import math

import numpy as np
import pytest
from simulated_sensors import SimulatedSensors

from av_fusion.filter.outlier_rate import Trust


def learnt(share_wrong, seconds=40.0, seed=1):
    """Share of other sources that is learnt when a share of the seconds is heard 60 degrees off."""
    random, senses, trust = np.random.default_rng(seed), SimulatedSensors(seed), Trust(0.01)
    for second in range(int(seconds)):
        off = math.radians(60.0) if random.random() < share_wrong else 0.0
        for step in range(10):
            time = 100.0 + second + 0.1 * step
            trust.compare(senses.hear(time, 0.2 + off), time, 0.2)
    return trust.otherwise(1.0)


@pytest.mark.parametrize('share_wrong', [0.0, 0.3, 0.9])
def test_the_share_is_found(share_wrong):
    """Within what 40 draws of it allow, two standard deviations, and the prior's pull."""
    assert abs(learnt(share_wrong) - share_wrong) < 0.05 + 2.0 * math.sqrt(share_wrong * (1.0 - share_wrong) / 40.0)


def test_the_mirror_image_is_no_disagreement():
    """A pair hears the back's image of what is seen in front: that is the same sound."""
    trust, senses = Trust(0.01), SimulatedSensors(2)
    for step in range(200):
        trust.compare(senses.hear(0.1 * step, math.pi - 0.3), 0.1 * step, 0.3)
    assert trust.otherwise(1.0) < 0.02


def test_unsure_sounds_are_trusted_less_and_zero_switches_it_off():
    """What is heard surely is the target's; a confidence of zero says nothing."""
    assert Trust(0.01).otherwise(0.95) < 0.02 < 0.5 < Trust(0.01).otherwise(0.2)
    trust, senses = Trust(0.0), SimulatedSensors(3)
    for step in range(100):
        trust.compare(senses.hear(0.1 * step, 1.5), 0.1 * step, 0.0)
    assert trust.otherwise(0.2) == 0.0
