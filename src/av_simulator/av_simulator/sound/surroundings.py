"""Surroundings of sources and microphones: ground, obstacles, room and reverberation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from av_common.config_reader import bounded
from av_simulator.sound.ground import Ground
from av_simulator.sound.obstacles import OBSTACLES, Absorption, Obstacle, reflection_factor
from av_simulator.sound.reverberation import NARROWEST, ReverbZone


@dataclass(frozen=True)
class Room:
    """A box-shaped room whose walls reflect sound (image sources, Allen and Berkley 1979). Raises ValueError.

    Parameters:
        minimum, maximum (m, ENU): corners.
        absorption: absorption coefficients of the walls, one value or one for each octave.
        order: maximum number of reflections of a ray.
    """

    minimum: Sequence[float] = bounded(low=-1e3, high=1e3, longest=3)
    maximum: Sequence[float] = bounded(low=-1e3, high=1e3, longest=3)
    absorption: Absorption = (0.2,)
    order: int = bounded(2, low=0, high=8)

    def __post_init__(self) -> None:
        if not len(self.minimum) == len(self.maximum) == 3 or np.subtract(self.maximum, self.minimum).min() < NARROWEST:
            raise ValueError(f'room minimum is {list(self.minimum)} and maximum {list(self.maximum)}, '
                             f'expected x, y, z, minimum < maximum by at least {NARROWEST} m')
        reflection_factor(self.absorption, np.zeros(1))   # raises ValueError for impossible ones


@dataclass(frozen=True)
class Surroundings:
    """Surroundings of sources and microphones. Raises ValueError for a ground in addition to a room.

    Parameters:
        ground: a plane that reflects sound.
        obstacles: obstacles that shade and reflect sound.
        room: walls, floor and ceiling.
        zones: zones with late reverberation.
    """

    ground: Ground | None = None
    obstacles: Sequence[Annotated[Obstacle, OBSTACLES]] = ()
    room: Room | None = None
    zones: Sequence[ReverbZone] = ()

    def __post_init__(self) -> None:
        if self.ground is not None and self.room is not None:
            raise ValueError('ground and room are both given, expected one: the floor of the room is its ground')
