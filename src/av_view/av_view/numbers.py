"""Numbers that JSON can hold, and the limits of what viewers are sent."""

from __future__ import annotations

import math

LONGEST_TEXT, LONGEST_NAME = 400, 40  # characters of a text, or a name, that comes from a message
MOST_BOXES, MOST_TRACKS, MOST_GROUPS = 50, 50, 8
STALE_S = 1.0  # age from which a measurement is no longer shown
PICTURE_STALE_S = 3.0  # the same of a picture: cameras may be slow


def number(value: float, digits: int = 2) -> float | None:
    """A rounded number; None for one that is not finite.

    Parameters:
        value: the number.
        digits: after the point.
    """
    return round(float(value), digits) if math.isfinite(value) else None


def degrees(angle: float) -> float | None:
    """An angle (rad) in degrees; None where it is not finite."""
    return number(math.degrees(angle), 1)
