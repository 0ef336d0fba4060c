"""Cues: where others say that a target is, seen from the rig (`target/cue`)."""

from __future__ import annotations

import math

from geometry_msgs.msg import PointStamped

CUE_SIGMA = math.radians(10.0)  # rad, of the direction up to which a cue is told, and which is assumed of it
LEAST_DISTANCE_M, MOST_DISTANCE_M = 0.1, 1e6


def cue_direction(message: PointStamped) -> tuple[float, float, float]:
    """Unit vector from the rig to a cue, in the cue's frame: the world's or the body's axes at the rig.

    Raises ValueError for a place that is not finite, or at the rig.
    """
    x, y, z = message.point.x, message.point.y, message.point.z
    distance = math.hypot(x, y, z)
    if not LEAST_DISTANCE_M <= distance <= MOST_DISTANCE_M:
        raise ValueError(f'cue at ({x:g}, {y:g}, {z:g}) m, expected {LEAST_DISTANCE_M} to {MOST_DISTANCE_M:g} m from the rig')
    return x / distance, y / distance, z / distance
