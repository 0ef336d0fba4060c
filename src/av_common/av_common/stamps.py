"""Stamps of ROS as seconds and back; a float64 resolves today's epoch to 0.24 microseconds."""

from __future__ import annotations

from builtin_interfaces.msg import Time

# A stamp ends at 2^31 s, in 2038. The last hour is not accepted, so that times a little after an accepted one have stamps.
END_S = 2**31
LATEST_S = END_S - 3600


def to_seconds(stamp: Time) -> float:
    """Time of a stamp in s since the clock's epoch. Raises ValueError outside of 0..LATEST_S, and from 1e9 ns on."""
    if not (0 <= stamp.sec <= LATEST_S and 0 <= stamp.nanosec < 10**9):
        raise ValueError(f'stamp {stamp.sec} s {stamp.nanosec} ns, expected 0 to {LATEST_S} s and less than 1e9 ns')
    return stamp.sec + 1e-9 * stamp.nanosec


def to_stamp(seconds: float) -> Time:
    """Stamp of a time in s since the epoch. Raises ValueError outside of 0..2^31 s and for values that are not finite."""
    if not 0.0 <= seconds < END_S - 1:
        raise ValueError(f'a stamp holds 0..2^31 seconds, not {seconds}')
    whole = int(seconds)
    nanoseconds = round((seconds - whole) * 1e9)
    return Time(sec=whole + nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
