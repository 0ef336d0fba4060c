"""How agile a target counts, by what it surprises with."""

from __future__ import annotations

import pytest

from av_fusion.filter.process_noise import LARGEST, LEAST, AdaptiveProcessNoise


def after(measurements, surprise, rate, noise_scale=None):
    """Agility after independent measurements that surprise so much (innovation squared over variance)."""
    noise_scale = noise_scale or AdaptiveProcessNoise()
    for _ in range(measurements):
        noise_scale.note(1.0, rate, surprise**0.5, 1.0)
        noise_scale.adapt(1.0)
    return noise_scale


def test_surprises_raise_it_at_once_and_their_absence_lowers_it():
    """Three sigma once is enough; it falls again within ten calm measurements, to the usual."""
    startled = after(1, 9.0, 0.2)
    assert startled.value == LARGEST
    assert after(10, 0.5, 0.0, startled).value == pytest.approx(1.0)


def test_only_who_moves_evenly_for_long_counts_as_calm():
    """Little changes in four measurements, much in a hundred, nothing for one that hangs in the air; a surprise ends it."""
    assert after(4, 0.5, 0.2).value > 0.7
    calm = after(100, 0.5, 0.2)
    assert calm.value == LEAST
    assert after(100, 0.5, 0.0).value == 1.0
    assert after(1, 9.0, 0.2, calm).value == LARGEST
