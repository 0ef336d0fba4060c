"""Levels: dB SPL and pascals. The unit of every signal of this package is the pascal."""

from __future__ import annotations

REFERENCE_PA = 20e-6


def db_to_ratio(level_db: float) -> float:
    """Amplitude ratio of a level in dB."""
    return 10.0 ** (level_db / 20.0)


def spl_to_pascal(level_db_spl: float) -> float:
    """Root mean square pressure in Pa of a sound pressure level."""
    return REFERENCE_PA * db_to_ratio(level_db_spl)
