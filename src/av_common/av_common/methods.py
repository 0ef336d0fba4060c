"""Methods by name: those of the suite, and those that other installed packages offer as entry points.

A package offers a method by a line of `entry_points` in its setup.py or pyproject.toml, such as
`'av_rig.doa': ['mine = my_package.estimator:Mine']`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any


class Methods:
    """The methods of one kind. A name of the suite cannot be taken by another package.

    Parameters:
        group: of entry points.
        own: the suite's own methods by name, as 'module:attribute'.
        parameter: by which users name one.
        others: what else may be named there, such as a file.
    """

    def __init__(self, group: str, own: Mapping[str, str], parameter: str = 'method', others: str = '') -> None:
        self.group, self._own, self._parameter, self._others = group, dict(own), parameter, others

    @cached_property
    def _places(self) -> dict[str, str]:
        """Where each method is, those of the suite first."""
        return {**self._own, **{entry.name: entry.value for entry in entry_points(group=self.group)
                                if entry.name not in self._own}}

    @property
    def others(self) -> list[str]:
        """Names of the methods of other packages."""
        return [name for name in self._places if name not in self._own]

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
            raise ValueError(f'{self._parameter} {name!r}, expected {self._others}one of {", ".join(self.names)}; others are '
                             f'found as entry points {self.group} of installed packages')

    def code(self, name: str) -> str:
        """Digest of the files of the distribution that offers a method; empty for an unknown name.

        Files that are not Python's, such as weights, count by size and time of change.
        """
        digest = hashlib.sha256()
        for file in sorted(set(self._files(name))):
            status = file.stat()
            content = file.read_bytes() if file.suffix == '.py' else f'{status.st_size} {status.st_mtime_ns}'.encode()
            digest.update(str(file).encode() + content)
        return digest.hexdigest() if name in self._places else ''

    def _files(self, name: str) -> Iterator[Path]:
        """Files of the module of a method, and of the other modules of its distribution, also where that is editable."""
        if name not in self._places:
            return
        found = [entry.dist for entry in entry_points(group=self.group) if entry.name == name and entry.dist is not None]
        modules = [self._places[name].partition(':')[0].partition('.')[0]]
        modules += [module for one in found for module in (one.read_text('top_level.txt') or '').split()]
        for spec in filter(None, map(find_spec, modules)):
            if spec.submodule_search_locations is None:
                yield Path(str(spec.origin))
            for folder in spec.submodule_search_locations or ():
                yield from (file for file in Path(folder).rglob('*') if file.is_file() and file.suffix != '.pyc')
