"""Cells of space as key expressions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PARTS = 4  # of a cell along each side, so that a rig's reports go only to the cells that it reaches
REPORTS, TRACKS = 'av/report', 'av/track'  # beginnings of the keys


@dataclass(frozen=True)
class Grid:
    """Square cells from the origin to the east and to the north, each divided into PARTS x PARTS.

    Parameters:
        cells: along each side.
        size (m): of a cell.
        reach (m): from a rig to the farthest target that it measures.
    """

    cells: int
    size: float
    reach: float

    def cell_of(self, position: NDArray[np.float64]) -> tuple[int, int]:
        """The cell (east, north) of a place; that of one outside is the nearest one."""
        x, y = (min(max(int(value // self.size), 0), self.cells - 1) for value in position[:2])
        return x, y

    def report_key(self, rig: str, position: NDArray[np.float64]) -> str:
        """The key of a rig's reports: the part of a cell in which it stands, and its name."""
        cell = np.array(self.cell_of(position))
        part = np.clip((position[:2] - self.size * cell) // (self.size / PARTS), 0, PARTS - 1).astype(int)
        return f'{REPORTS}/{cell[0]}/{cell[1]}/{part[0]}/{part[1]}/{rig}'

    def neighbours(self, cell: tuple[int, int]) -> Iterator[tuple[int, int]]:
        """The cells around a cell."""
        for x in range(max(cell[0] - 1, 0), min(cell[0] + 2, self.cells)):
            for y in range(max(cell[1] - 1, 0), min(cell[1] + 2, self.cells)):
                if (x, y) != cell:
                    yield x, y

    def parts(self, cell: tuple[int, int]) -> list[str]:
        """The parts of cells whose rigs reach a cell, as in their keys: east, north, east and north within.

        Raises ValueError for a reach beyond the neighbours.
        """
        if self.reach > self.size:
            raise ValueError(f'reach is {self.reach:g} m, expected up to the size of a cell, {self.size:g} m')
        depth, all_parts = -int(-self.reach // (self.size / PARTS)), range(PARTS)
        found = [f'{cell[0]}/{cell[1]}/{x}/{y}' for x in all_parts for y in all_parts]
        for other in self.neighbours(cell):
            columns, rows = (all_parts if step == 0 else range(depth) if step > 0 else range(PARTS - depth, PARTS)
                             for step in (other[0] - cell[0], other[1] - cell[1]))
            found += [f'{other[0]}/{other[1]}/{x}/{y}' for x in columns for y in rows]
        return found

    def passes(self, cell: tuple[int, int], origin: NDArray[np.float64], unit: NDArray[np.float64], margin: float) -> bool:
        """Whether a direction within its reach comes as near to a cell as a margin (m), seen from above."""
        points = origin[:2] + np.linspace(0.0, self.reach, 9)[:, None] * unit[:2]
        low = self.size * np.array(cell) - margin
        return bool(np.any(np.all((points > low) & (points < low + self.size + 2.0 * margin), axis=1)))
