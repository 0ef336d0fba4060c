"""Sound at a head that turns amid reflections, in steps, against one convolution of the whole."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from av_evaluation.experiments.turning_ears import STEP_S, Ears
from av_evaluation.hearing.places import at_ears

RATE, GRID = 8000, np.radians(np.arange(0.0, 360.0, 5.0))


@pytest.mark.parametrize('turned', [0.0, 90.0])
def test_a_head_at_rest_hears_what_one_convolution_gives(turned):
    rng = np.random.default_rng(3)
    head = SimpleNamespace(rate=RATE, azimuths=GRID, responses=rng.normal(size=(72, 2, 40)))
    ears = Ears(head, np.pad(rng.normal(size=RATE), RATE // 10), rng)
    ears._noise, yaw = 1e-9, np.radians(turned)
    heard = np.concatenate([ears.hear(yaw, yaw) for _ in range(10)]) * ears._noise / 0.02
    voice = ears._voice[:len(heard)]
    expected = at_ears(voice, ears._tail)
    for azimuth, delay, gain in ears._paths:
        share, below = np.modf((azimuth - yaw) / np.radians(5.0) % 72.0)
        response = (1.0 - share) * head.responses[int(below)] + share * head.responses[(int(below) + 1) % 72]
        expected += gain * at_ears(np.concatenate([np.zeros(delay), voice])[:len(voice)], response)
    assert len(heard) == round(10 * STEP_S * RATE) and len(ears._paths) > 1
    np.testing.assert_allclose(heard, expected, atol=1e-5 * expected.std())
