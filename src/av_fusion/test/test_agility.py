"""How agile a target counts, by what it surprises with."""

from __future__ import annotations

import pytest

from av_fusion.filter.process_noise import LEAST, MOST, Agility


def after(measurements, surprise, rate, agility=None):
    """Agility after independent measurements that surprise so much (innovation squared over variance)."""
    agility = agility or Agility()
    for _ in range(measurements):
        agility.note(1.0, rate, surprise**0.5, 1.0)
        agility.adapt(1.0)
    return agility


def test_surprises_raise_it_at_once_and_their_absence_lowers_it():
    """Three sigma once is enough; it falls again within ten calm measurements, to the usual."""
    startled = after(1, 9.0, 0.2)
    assert startled.value == MOST
    assert after(10, 0.5, 0.0, startled).value == pytest.approx(1.0)


def test_only_who_moves_evenly_for_long_counts_as_calm():
    """Little changes in four measurements, much in a hundred, nothing for one that hangs in the air; a surprise ends it."""
    assert after(4, 0.5, 0.2).value > 0.7
    calm = after(100, 0.5, 0.2)
    assert calm.value == LEAST
    assert after(100, 0.5, 0.0).value == 1.0
    assert after(1, 9.0, 0.2, calm).value == MOST
