"""Figures of contracts with their bounds. As a program it prints the recorded ones, of several runs side by side:

CONTRACT_FIGURES=old.json python3 -m pytest test/contracts; python3 test/contracts/figures.py old.json new.json
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Bound:
    """A figure and what it must be.

    Parameters:
        name: of the figure.
        value: as measured.
        least, most: it must lie between these.
        unit: of all three.
    """

    name: str
    value: float
    least: float = -math.inf
    most: float = math.inf
    unit: str = ''

    @property
    def holds(self) -> bool:
        """Whether the figure lies between its bounds; NaN does not."""
        return self.least <= self.value <= self.most

    def row(self) -> list:
        """Value, bounds as text, and whether it holds, for the file of figures."""
        return [float(self.value), self.bounds, bool(self.holds)]

    @property
    def bounds(self) -> str:
        """The bounds as text."""
        low = f'>= {self.least:g} ' if self.least > -math.inf else ''
        high = f'<= {self.most:g} ' if self.most < math.inf else ''
        return f'{low}{high}{self.unit}'.strip()

    def __str__(self) -> str:
        return f'{self.name} is {self.value:.4g}, expected {self.bounds}'


def at_most(name: str, value: float, most: float, unit: str = '') -> Bound:
    return Bound(name, value, most=most, unit=unit)


def at_least(name: str, value: float, least: float, unit: str = '') -> Bound:
    return Bound(name, value, least=least, unit=unit)


def within(name: str, value: float, least: float, most: float, unit: str = '') -> Bound:
    return Bound(name, value, least, most, unit)


def main(files: list[str]) -> None:
    """Print a table of the figures in files that runs have written."""
    runs = [json.loads(Path(file).read_text()) for file in files]
    names = list(dict.fromkeys(name for run in runs for name in run))
    print('figure', 'bound', *(Path(file).stem for file in files), sep=' | ')
    for name in names:
        rows = [run.get(name) for run in runs]
        bound = next(row[1] for row in rows if row)
        print(name, bound, *('-' if row is None else f'{row[0]:.4g}{"" if row[2] else " !"}' for row in rows), sep=' | ')


if __name__ == '__main__':
    main(sys.argv[1:])
