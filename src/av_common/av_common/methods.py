"""Methods by name: those of the suite, and those that other installed packages offer as entry points.

A package offers a method by a line of `entry_points` in its setup.py or pyproject.toml, such as
`'av_rig.doa': ['mine = my_package.estimator:Mine']`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any


class Methods:
    """The methods of one kind. A name of the suite cannot be taken by another package.

    Parameters:
        group: of entry points.
        own: the suite's own methods by name, as 'module:attribute'.
    """

    def __init__(self, group: str, own: Mapping[str, str]) -> None:
        self.group, self._own = group, dict(own)

    @cached_property
    def _places(self) -> dict[str, str]:
        """Where each method is, those of the suite first."""
        return {**self._own, **{entry.name: entry.value for entry in entry_points(group=self.group)
                                if entry.name not in self._own}}

    @property
    def names(self) -> list[str]:
        """Names of all that can be loaded, those of the suite first."""
        return list(self._places)

    def load(self, name: str) -> Any:
        """What makes a method. Raises ValueError for a name that is not installed, or that cannot be imported."""
        self.check(name)
        module, _, attribute = self._places[name].partition(':')
        try:
            return getattr(import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            raise ValueError(f'method {name!r} of {self.group} cannot be loaded from {self._places[name]}: {error}') from error

    def check(self, name: str) -> None:
        """Raises ValueError for an unknown name, with those that are installed."""
        if name not in self._places:
            raise ValueError(f'method {name!r}, expected one of {", ".join(self.names)}; others are found as entry points '
                             f'{self.group} of installed packages')
