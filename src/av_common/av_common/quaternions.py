"""Unit quaternions as plain numbers: for single ones faster than arrays.

A rotation turns vectors of a frame into its parent, such as the body into the world.
"""

from __future__ import annotations

import math

Vector = tuple[float, float, float]
Rows = tuple[Vector, Vector, Vector]  # of a rotation matrix
Quaternion = tuple[float, float, float, float]  # w, x, y, z


def rotation(q: Quaternion) -> Rows:
    """Rotation of a unit quaternion."""
    w, x, y, z = q
    return ((1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)))


def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """The rotation q followed by p."""
    a, b, c, d = p
    w, x, y, z = q
    return (a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w)


def inverse(q: Quaternion) -> Quaternion:
    """The inverse of a rotation, given and returned as a unit quaternion."""
    return q[0], -q[1], -q[2], -q[3]


def quaternion_of(v: Vector) -> Quaternion:
    """The rotation about a vector by its length (rad)."""
    angle = math.hypot(*v)
    scale = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), scale * v[0], scale * v[1], scale * v[2]


def vector_of(q: Quaternion) -> Vector:
    """Axis times angle (rad, at most pi) of a rotation; the inverse of `quaternion_of`."""
    w, x, y, z = q if q[0] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, w) / sine
    return scale * x, scale * y, scale * z


def between(p: Quaternion, q: Quaternion, share: float) -> Quaternion:
    """Spherical interpolation from p (share 0) to q (share 1); also extrapolation."""
    step = vector_of(product(inverse(p), q))
    return product(p, quaternion_of((share * step[0], share * step[1], share * step[2])))
