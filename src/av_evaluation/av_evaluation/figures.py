"""Measured values with their bounds."""

from __future__ import annotations

from dataclasses import dataclass


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
