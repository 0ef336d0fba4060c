"""Measured values with their bounds, and the programs that print them by section."""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

Sections = Mapping[str, Callable[[], Iterator['Figure']]]


@dataclass(frozen=True)
class Figure:
    """A measured value with its bounds.

    Parameters:
        name: description of the value.
        value: the value.
        unit: its unit.
        at_most: upper bound, None without.
        at_least: lower bound, None without.
    """

    name: str
    value: float
    unit: str = ''
    at_most: float | None = None
    at_least: float | None = None

    @property
    def holds(self) -> bool:
        """Whether the value is within its bounds."""
        return (self.at_most is None or self.value <= self.at_most) and (
            self.at_least is None or self.value >= self.at_least)

    def __str__(self) -> str:
        bounds = [f'>= {self.at_least:g}'] if self.at_least is not None else []
        bounds += [f'<= {self.at_most:g}'] if self.at_most is not None else []
        verdict = f'must be {" and ".join(bounds)}: {"ok" if self.holds else "MISSED"}' if bounds else ''
        return f'  {self.name:<66} {self.value:9.4g} {self.unit:<6} {verdict}'.rstrip()


def print_sections(parser: ArgumentParser, sections: Sections, wanted: Sequence[str]) -> int:
    """Print the figures of some sections, all where none is named; returns 1 where a figure misses its bound, else 0.

    A section whose recordings or libraries are missing (FileNotFoundError, ImportError) is left out with a line that says so.

    Parameters:
        parser: of the program, which ends it where a section is unknown.
        sections: the figures by section.
        wanted: names of sections.
    """
    if unknown := set(wanted) - set(sections):
        parser.error(f'unknown section {", ".join(sorted(unknown))}; known are {", ".join(sections)}')
    held = [_print(name, sections[name]()) for name in wanted or sections]
    return 0 if all(held) else 1


def _print(name: str, figures: Iterable[Figure]) -> bool:
    print(name, flush=True)
    held = True
    try:
        for figure in figures:
            print(figure, flush=True)
            held &= figure.holds
    except (FileNotFoundError, ImportError) as error:
        print(f'  skipped: {error}')
    return held
