"""What others may ask of the rig."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Follow:
    """The rig is to follow the track `id`."""

    id: int


@dataclass(frozen=True)
class LookAt:
    """The rig is to look in a direction.

    Parameters:
        azimuth (rad): clockwise, from true north or from the rig's forward direction.
        elevation (rad): up from the horizontal plane.
        north: whether the azimuth counts from true north.
    """

    azimuth: float
    elevation: float
    north: bool


@dataclass(frozen=True)
class Stop:
    """The rig is to do again what it did without a task."""


Command = Follow | LookAt | Stop
