"""Directions on the sphere: differences and motion in the tangent plane, where nothing is singular at the zenith."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from av_common.angles import angles_to_direction, direction_to_angles

Array = NDArray[np.float64]


def axes(angles: Array) -> Array:
    """Unit vectors (..., 2, 3) across (to larger azimuth) and up at directions (..., 2) (azimuth, elevation) (rad)."""
    a, e = angles[..., 0], angles[..., 1]
    across = np.stack([-np.sin(a), np.cos(a), np.zeros_like(a)], -1)
    up = np.stack([-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)], -1)
    return np.stack([across, up], -2)


def offsets(angles: Array, references: Array) -> Array:
    """Arcs (..., 2) (rad), across and up, from references (..., 2) to directions (..., 2) along great circles.

    Parameters:
        angles, references (rad): (azimuth, elevation), which broadcast.
    """
    units, centres = (angles_to_direction(each[..., 0], each[..., 1]) for each in (angles, references))
    plane = np.einsum('...ij,...j->...i', axes(references), units)
    sine, cosine = np.linalg.norm(plane, axis=-1), np.sum(units * centres, axis=-1)
    return np.asarray(plane * (np.arctan2(sine, cosine) / np.maximum(sine, 1e-12))[..., None])


def moved(references: Array, arcs: Array) -> Array:
    """Directions (..., 2) (azimuth, elevation) (rad) at arcs (..., 2) from others: the inverse of `offsets`.

    Parameters:
        references (..., 2) (rad): where the arcs begin.
        arcs (..., 2) (rad): across and up.
    """
    along = np.einsum('...i,...ij->...j', arcs, axes(references))
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    units = angles_to_direction(references[..., 0], references[..., 1])
    return np.stack(direction_to_angles(np.cos(length) * units + np.sinc(length / np.pi) * along), -1)


def carried(vectors: Array, begin: Array, end: Array) -> Array:
    """Vectors (..., 3) perpendicular to directions (..., 2), carried along great circles to others (..., 2).

    Parameters:
        vectors (..., 3): in the world.
        begin, end (..., 2) (rad): where they are, and where they come to, which is not opposite.
    """
    a, b = (angles_to_direction(each[..., 0], each[..., 1]) for each in (begin, end))
    along = np.sum(vectors * b, axis=-1) / np.maximum(1.0 + np.sum(a * b, axis=-1), 1e-12)
    return np.asarray(vectors - along[..., None] * (a + b))
