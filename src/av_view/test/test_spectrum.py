"""Levels of bands, held against the power of sines and of noise."""

from __future__ import annotations

import numpy as np
import pytest

from av_view.spectrum import BANDS, FLOOR_DB, HIGHEST_HZ, LOWEST_HZ, spectrum

EDGES = np.geomspace(LOWEST_HZ, HIGHEST_HZ, BANDS + 1)


def test_a_sine_is_in_its_band_with_its_power():
    time = np.arange(4800) / 48_000
    levels = spectrum(0.5 * np.sin(2 * np.pi * 3000.0 * time)[:, None], 48_000)
    band = np.searchsorted(EDGES, 3000.0) - 1
    assert levels.argmax() == band
    assert 10.0 * np.log10(np.sum(10.0 ** (0.1 * levels))) == pytest.approx(20.0 * np.log10(0.5) - 3.01, abs=0.2)


def test_white_noise_has_its_power_in_proportion_to_bandwidth():
    noise = np.random.default_rng(1).normal(0.0, 0.1, (48_000, 2))
    power = 10.0 ** (0.1 * spectrum(noise, 48_000))
    expected = 0.01 * np.diff(EDGES) / 24_000
    assert power[20:] == pytest.approx(expected[20:], rel=0.3)
    assert power.sum() == pytest.approx(expected.sum(), rel=0.03)


def test_nothing_is_heard_above_half_the_rate():
    noise = np.random.default_rng(2).normal(0.0, 0.1, (1600, 1))
    assert (spectrum(noise, 16_000)[EDGES[1:] > 8000.0] == FLOOR_DB).all()
    assert spectrum(np.zeros((512, 2)), 48_000) == pytest.approx(FLOOR_DB, abs=1e-6)


@pytest.mark.parametrize(('samples', 'rate'), [(np.zeros((1, 2)), 48_000), (np.zeros(100), 48_000), (np.zeros((100, 2)), 0),
                                               (np.ones((2, 2)), 48_000), (np.full((100, 2), np.nan), 48_000)])
def test_no_sound_is_an_error(samples, rate):
    with pytest.raises(ValueError, match='no spectrum'):
        spectrum(samples, rate)
