"""Conversion of levels. All signals of this package are sound pressures in Pa."""

from __future__ import annotations

REFERENCE_PA = 20e-6


def db_to_ratio(level_db: float) -> float:
    """Amplitude ratio of a level in dB."""
    return 10.0 ** (level_db / 20.0)


def spl_to_pascal(level_db_spl: float) -> float:
    """Root mean square pressure (Pa) of a sound pressure level (dB)."""
    return REFERENCE_PA * db_to_ratio(level_db_spl)
