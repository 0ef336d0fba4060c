"""What stands around source and microphones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from av_simulator.sound.ground import Ground
from av_simulator.sound.materials import Absorption, reflection_factor
from av_simulator.sound.obstacles import OBSTACLES, Obstacle
from av_simulator.sound.reverberation import ReverbZone


@dataclass(frozen=True)
class Room:
    """A box around everything, whose walls mirror sound (image sources, Allen and Berkley 1979).

    Parameters:
        minimum, maximum (m, ENU): corners.
        absorption: of all walls, one value or one for each octave.
        wall_absorption: of the walls at the least and greatest x, y and z, instead.
        order: reflections of a ray at most.
    """

    minimum: Sequence[float]
    maximum: Sequence[float]
    absorption: Absorption = (0.2,)
    wall_absorption: Sequence[Absorption] | None = None
    order: int = 2

    def __post_init__(self) -> None:
        if not np.all(np.less(self.minimum, self.maximum)):
            raise ValueError(f'room minimum is {list(self.minimum)} and maximum {list(self.maximum)}, '
                             'expected minimum < maximum')
        if self.order < 0:
            raise ValueError(f'room order is {self.order}, expected 0 or more')
        if len(self.walls) != 6:
            raise ValueError(f'room wall_absorption has {len(self.walls)} entries, expected 6')
        for absorption in self.walls:
            reflection_factor(absorption, np.zeros(1))

    @property
    def walls(self) -> list[Absorption]:
        """Absorption of the six walls."""
        return [self.absorption] * 6 if self.wall_absorption is None else list(self.wall_absorption)


@dataclass(frozen=True)
class Surroundings:
    """What stands around source and microphones.

    Parameters:
        ground: a plane.
        obstacles: shade and mirror.
        room: walls; its floor is its ground.
        zones: with late reverberation.
    """

    ground: Ground | None = None
    obstacles: Sequence[Annotated[Obstacle, OBSTACLES]] = ()
    room: Room | None = None
    zones: Sequence[ReverbZone] = ()

    @property
    def open(self) -> bool:
        """Whether sound meets nothing on its way."""
        return self.ground is None and self.room is None and not self.obstacles

    def __post_init__(self) -> None:
        if self.ground is not None and self.room is not None:
            raise ValueError('ground and room are both given, expected one: the floor of the room is its ground')
