"""Stamps of ROS as seconds and back; a float64 resolves today's epoch to 0.24 microseconds."""

from __future__ import annotations

from builtin_interfaces.msg import Time


def to_seconds(stamp: Time) -> float:
    """Time of a stamp in s since the clock's epoch."""
    return stamp.sec + 1e-9 * stamp.nanosec


def to_stamp(seconds: float) -> Time:
    """Stamp of a time in s since the epoch. Raises ValueError outside of 0..2^31 s."""
    if not 0.0 <= seconds < 2.0**31:
        raise ValueError(f'a stamp holds 0..2^31 seconds, not {seconds}')
    whole = int(seconds)
    nanoseconds = round((seconds - whole) * 1e9)
    return Time(sec=whole + nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
