"""Vectors, rotations and directions as plain numbers: for single ones faster than arrays.

A rotation is given by the rows of its matrix, and turns vectors of a frame into its parent: see `av_common.quaternions`.
"""

from __future__ import annotations

import math
from typing import Any

from av_common.quaternions import Rows as Rows
from av_common.quaternions import Vector as Vector

IDENTITY: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ZERO: Vector = (0.0, 0.0, 0.0)


def rows_of(matrix: Any) -> Rows:
    """Rows of a matrix (3, 3)."""
    a, b, c = matrix.tolist()
    return (a[0], a[1], a[2]), (b[0], b[1], b[2]), (c[0], c[1], c[2])


def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def combined(s: float, a: Vector, t: float, b: Vector) -> Vector:
    """The vector s a + t b."""
    return s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2]


def turned(rows: Rows, v: Vector) -> Vector:
    """A vector turned by a rotation: from the frame to its parent."""
    x, y, z = v
    (a, b, c), (d, e, f), (g, h, i) = rows
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def turn_between(before: Rows, after: Rows) -> Rows:
    """The rotation, in the parent's frame, that turns a frame from one rotation to another."""
    x, y, z = [(dot(row, before[0]), dot(row, before[1]), dot(row, before[2])) for row in after]
    return x, y, z


def turned_back(rows: Rows, v: Vector) -> Vector:
    """A vector turned by the inverse of a rotation: from the parent to the frame."""
    x, y, z = v
    (a, b, c), (d, e, f), (g, h, i) = rows
    return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z


def heading(yaw: float) -> Rows:
    """The rotation of a level frame that is turned by a yaw (rad)."""
    c, s = math.cos(yaw), math.sin(yaw)
    return (c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)


def direction(azimuth: float, elevation: float = 0.0) -> Vector:
    """Unit vector of an azimuth and an elevation (rad)."""
    level = math.cos(elevation)
    return level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)


def angles(v: Vector) -> tuple[float, float]:
    """Azimuth and elevation (rad) of a vector; the inverse of `direction`."""
    return math.atan2(v[1], v[0]), math.atan2(v[2], math.hypot(v[0], v[1]))


def tangents(azimuth: float, elevation: float) -> tuple[Vector, Vector]:
    """Unit vectors across (to larger azimuth) and up, perpendicular to a direction; also at the zenith."""
    c, s, climb = math.cos(azimuth), math.sin(azimuth), math.sin(elevation)
    return (-s, c, 0.0), (-c * climb, -s * climb, math.cos(elevation))


def offset(origin: Vector, left: Vector, above: Vector, target: Vector) -> tuple[float, float]:
    """Where a direction is from another one, along both axes (rad) of the plane that touches the sphere there."""
    x, y = dot(left, target), dot(above, target)
    sine = math.hypot(x, y)
    scale = math.atan2(sine, dot(origin, target)) / sine if sine > 1e-12 else 1.0
    return scale * x, scale * y
