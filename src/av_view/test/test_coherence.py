"""The signal-to-noise ratio, held against mixtures of known power."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_view.spectrum import Coherence

RATE, BLOCK = 48_000, 1536


def listen(snr_db, delay=5, channels=2, blocks=40):
    """A common noise that reaches each channel `delay` samples later than the one before, in independent noise."""
    rng = np.random.default_rng(5)
    coherence, found = Coherence(), math.nan
    for _ in range(blocks):
        source = rng.normal(size=BLOCK + delay * channels) * 10.0 ** (0.05 * snr_db)
        common = np.stack([source[delay * k:delay * k + BLOCK] for k in range(channels)], axis=1)
        found = coherence.add(common + rng.normal(size=(BLOCK, channels)), RATE, 0.25)
    return found


@pytest.mark.parametrize('channels', [2, 4])
@pytest.mark.parametrize('snr_db', [0.0, 10.0, 20.0])
def test_the_ratio_is_that_of_the_mixture(snr_db, channels):
    assert listen(snr_db, channels=channels) == pytest.approx(snr_db, abs=2.0)


def test_noise_alone_is_far_below():
    assert listen(-60.0) < -6.0


def test_what_has_no_ratio_is_unknown():
    for samples, rate in ((np.zeros((BLOCK, 1)), RATE), (np.zeros((4, 2)), RATE), (np.zeros((BLOCK, 2)), 0),
                          (np.zeros((BLOCK, 2)), RATE)):
        assert math.isnan(Coherence().add(samples, rate, 0.25))
