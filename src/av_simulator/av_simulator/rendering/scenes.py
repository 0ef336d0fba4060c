"""Kinds of scenes. Each is a list of simple solids, generated from a seed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from av_common.config_reader import bounded

Colour = tuple[float, float, float]   # red, green, blue, 0 to 1


@dataclass(frozen=True)
class Solid:
    """One simple body.

    Parameters:
        shape: `box`, `cylinder` (upright), `ellipsoid` or `cone` (upright).
        centre (m, (3,)): centre in ENU.
        half_size (m, (3,)): half extents along the body's axes.
        colour (0 to 1): red, green, blue.
        yaw (rad): rotation about the vertical, counter-clockwise.
        surface: name of a texture, '' for none.
        warmer_k (K): temperature difference from the air.
    """

    shape: str
    centre: Sequence[float]
    half_size: Sequence[float]
    colour: Colour
    yaw: float = 0.0
    surface: str = ''
    warmer_k: float = 0.0


def _scattered(random: np.random.Generator, count: int, nearest: float, farthest: float) -> NDArray:
    """Positions (m, (count, 2)), uniformly distributed over a ring around the origin."""
    radius = np.sqrt(random.uniform(nearest**2, farthest**2, count))
    angle = random.uniform(0.0, 2 * np.pi, count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _tree(random: np.random.Generator, x: float, y: float, height: float, conifer: bool) -> Iterator[Solid]:
    shade = random.uniform(0.75, 1.2)
    trunk = 0.02 * height + 0.06
    bark = (0.30 * shade, 0.23 * shade, 0.17 * shade)
    yield Solid('cylinder', (x, y, 0.25 * height), (trunk, trunk, 0.25 * height), bark, warmer_k=0.5)
    if conifer:
        green = (0.13 * shade, 0.26 * shade, 0.16 * shade)
        for share, width in ((0.42, 0.20), (0.72, 0.13)):
            yield Solid('cone', (x, y, share * height), (width * height, width * height, 0.28 * height), green)
    else:
        green = (0.20 * shade, 0.36 * shade, 0.15 * shade)
        yield Solid('ellipsoid', (x, y, 0.66 * height), (0.19 * height, 0.19 * height, 0.30 * height), green)
        dx, dy = random.uniform(-0.12, 0.12, 2) * height
        yield Solid('ellipsoid', (x + dx, y + dy, 0.56 * height), (0.15 * height, 0.15 * height, 0.17 * height), green)


def _trees(random: np.random.Generator, count: int, nearest: float, farthest: float, conifers: float) -> Iterator[Solid]:
    for x, y in _scattered(random, count, nearest, farthest):
        yield from _tree(random, x, y, random.uniform(5.0, 13.0), random.random() < conifers)


@dataclass(frozen=True)
class Woodland:
    """A clearing in a forest.

    Parameters:
        trees: number of trees.
        clearing (m): smallest distance of a tree from the origin.
        extent (m): largest distance of a tree from the origin.
    """

    trees: int = bounded(80, low=0, high=1000)
    clearing: float = bounded(16.0, low=0.0)
    extent: float = bounded(60.0, above=0.0)

    ground = 'forest'
    sky = True

    def __post_init__(self) -> None:
        if self.extent <= self.clearing:
            raise ValueError(f'extent: {self.extent} m, expected more than the clearing of {self.clearing} m')

    def solids(self, random: np.random.Generator) -> Iterator[Solid]:
        """Trees, bushes and rocks."""
        yield from _trees(random, self.trees, self.clearing, self.extent, 0.5)
        for x, y in _scattered(random, self.trees // 4, 0.7 * self.clearing, 0.7 * self.extent):
            size = random.uniform(0.3, 0.9)
            yield Solid('ellipsoid', (x, y, 0.5 * size), (size, size, 0.7 * size), (0.22, 0.33, 0.14))
        for x, y in _scattered(random, self.trees // 10, 0.5 * self.clearing, 0.7 * self.extent):
            size = random.uniform(0.2, 0.5)
            yield Solid('ellipsoid', (x, y, 0.2 * size), (size, 0.8 * size, 0.6 * size), (0.42, 0.41, 0.39))


@dataclass(frozen=True)
class Field:
    """Open grassland with a fence, hay bales and distant trees, of the radius `extent` (m)."""

    extent: float = bounded(120.0, above=20.0)

    ground = 'grass'
    sky = True

    def solids(self, random: np.random.Generator) -> Iterator[Solid]:
        """Trees at the edge, hay bales, fence posts."""
        yield from _trees(random, 40, 0.7 * self.extent, self.extent, 0.3)
        for x, y in _scattered(random, 8, 20.0, 60.0):
            yield Solid('cylinder', (x, y, 0.6), (0.7, 0.7, 0.6), (0.72, 0.62, 0.35))
        for x in np.arange(-40.0, 41.0, 4.0).tolist():
            yield Solid('box', (x, 25.0, 0.6), (0.06, 0.06, 0.6), (0.40, 0.33, 0.25))


@dataclass(frozen=True)
class Indoors:
    """A hall of `size` (m, (x, y, z)) around the origin, with walls, ceiling and lamps. Columns are obstacles of scenarios."""

    size: tuple[float, float, float] = (14.0, 10.0, 4.0)

    ground = 'concrete'
    sky = False

    def __post_init__(self) -> None:
        if min(self.size) <= 1.0:
            raise ValueError(f'size: {list(self.size)} m, expected more than 1 m each')

    def solids(self, random: np.random.Generator) -> Iterator[Solid]:
        """Four walls, a ceiling, tables and lamps."""
        x, y, z = (length / 2 for length in self.size)
        wall = (0.80, 0.79, 0.75)
        for sign in (-1, 1):
            yield Solid('box', (sign * (x + 0.1), 0.0, z), (0.1, y + 0.2, z), wall)
            yield Solid('box', (0.0, sign * (y + 0.1), z), (x, 0.1, z), wall)
        yield Solid('box', (0.0, 0.0, 2 * z + 0.1), (x + 0.2, y + 0.2, 0.1), (0.85, 0.85, 0.84))
        for lamp in np.linspace(-0.6 * x, 0.6 * x, 3):
            yield Solid('box', (lamp, 0.0, 2 * z - 0.04), (0.6, 0.15, 0.04), (1.0, 1.0, 0.97), warmer_k=12.0)
        for side in (-1, 1):
            place = (0.8 * x * side, 0.75 * y * side, 0.72)
            yield Solid('box', place, (0.8, 0.4, 0.03), (0.55, 0.42, 0.28))
            yield Solid('box', (place[0], place[1], 0.35), (0.05, 0.05, 0.35), (0.3, 0.3, 0.3))


@dataclass(frozen=True)
class UrbanEdge:
    """The edge of a town: a row of `buildings` to the north, a street with lamps and cars, open land to the south."""

    buildings: int = bounded(7, low=1, high=60)

    ground = 'grass'
    sky = True

    def solids(self, random: np.random.Generator) -> Iterator[Solid]:
        """Buildings, the street in front of them, lamps, cars and trees."""
        yield Solid('box', (0.0, 20.0, 0.01), (80.0, 4.0, 0.01), (0.30, 0.30, 0.31), surface='asphalt', warmer_k=2.0)
        for number in range(self.buildings):
            width, height = random.uniform(5.0, 8.0), random.uniform(4.0, 10.0)
            x = (number - (self.buildings - 1) / 2) * 16.0 + random.uniform(-1.0, 1.0)
            grey = random.uniform(0.5, 0.8)
            yield Solid('box', (x, 34.0, height), (width, 6.0, height), (grey, 0.95 * grey, 0.88 * grey),
                        surface='facade', warmer_k=1.5)
        for x in np.arange(-60.0, 61.0, 20.0).tolist():
            yield Solid('cylinder', (x, 15.0, 2.5), (0.08, 0.08, 2.5), (0.35, 0.36, 0.38))
            yield Solid('ellipsoid', (x, 15.0, 5.0), (0.25, 0.25, 0.15), (0.95, 0.95, 0.85), warmer_k=15.0)
        for x in random.uniform(-50.0, 50.0, 6):
            paint = tuple(random.uniform(0.1, 0.8, 3))
            yield Solid('box', (x, 21.5, 0.55), (2.1, 0.85, 0.4), paint, warmer_k=4.0)
            yield Solid('box', (x - 0.2, 21.5, 1.15), (1.1, 0.75, 0.3), (0.15, 0.17, 0.2), warmer_k=3.0)
        for x, y in _scattered(random, 25, 30.0, 90.0):
            if y < 8.0:
                yield from _tree(random, x, y, random.uniform(4.0, 9.0), conifer=False)


Scene = Woodland | Field | Indoors | UrbanEdge    # each has a ground, the name of its texture, and a sky where it is outdoors
SCENES = {'woodland': Woodland, 'field': Field, 'indoors': Indoors, 'urban': UrbanEdge}
AnyScene = Annotated[Any, SCENES]
