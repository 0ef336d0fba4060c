"""The map of several rigs: positions of targets and rigs with their ellipses, as plain data for viewers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from av_view.numbers import LONGEST_NAME, MOST_TRACKS, number

MOST_RIGS = 64  # of one map: as many as join a network


def world_part(message: Any) -> dict[str, Any]:
    """The tracks and rigs of a `WorldTrackArray`, in metres in its common frame, x to the east and y to the north."""
    tracks = [found for found in map(_track, message.tracks[:MOST_TRACKS]) if found is not None]
    return {'tracks': tracks, 'rigs': [_rig(rig) for rig in message.rigs[:MOST_RIGS] if _is_placed(rig.position)]}


def _track(track: Any) -> dict[str, Any] | None:
    """A target; None where its position is not known at all."""
    covariance = np.asarray(track.position_covariance, float).reshape(3, 3)[:2, :2]
    if not _is_placed(track.position) or not np.isfinite(covariance).all():
        return None
    return {'id': int(track.id), 'name': track.class_id[:LONGEST_NAME], 'ellipse': ellipse(covariance),
            **{axis: number(getattr(track.position, axis)) for axis in 'xyz'}, 'positioned': bool(track.positioned),
            'rigs': [name[:LONGEST_NAME] for name in track.rigs[:MOST_RIGS]]}


def ellipse(covariance: np.ndarray) -> list[float | None]:
    """The ellipse of one standard deviation: its half axes (m), the longer first, and the angle of that one from x (deg).

    Parameters:
        covariance (2, 2) (m^2): of a position.
    """
    variances, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    short, long = np.sqrt(np.maximum(variances, 0.0))
    return [number(long), number(short), number(math.degrees(math.atan2(axes[1, 1], axes[0, 1])), 1)]


def _rig(rig: Any) -> dict[str, Any]:
    return {'name': rig.name[:LONGEST_NAME], 'x': number(rig.position.x), 'y': number(rig.position.y),
            'sigma': number(rig.position_sigma)}


def _is_placed(position: Any) -> bool:
    return math.isfinite(position.x + position.y)
