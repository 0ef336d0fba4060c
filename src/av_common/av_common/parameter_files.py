"""Parameter files as ROS 2 reads them: sections by the names of nodes, with wildcards."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from av_common.config_reader import LARGEST_WHOLE
from av_common.files import shown
from av_common.yaml_reader import load_yaml


def parameters_for(file: str | Path, node: str) -> dict[str, Any]:
    """Parameters that a file sets for the node with this full name, by names with dots. Raises as `sections_of`.

    `rclpy.parameter.parameter_dict_from_yaml_file` finds neither the nodes of `/*/node`, `/**/namespace/node` and
    `namespace: node:`, nor those of `/**/node` without a namespace, and reads '1' in quotes as a number.
    """
    return {name: value for path, parameters in sections_of(file) if fits(path, node)
            for name, value in parameters.items()}


def fits(path: str, node: str) -> bool:
    """Whether a section is for a node.

    Parameters:
        path: of the section, as of `sections_of`; * is one name, ** any number.
        node: full name of the node.
    """
    wild = {'*': '/[^/]+', '**': '(/[^/]+)*'}
    return re.fullmatch(''.join(wild.get(part, '/' + re.escape(part)) for part in path.split('/')[1:]), node) is not None


def sections_of(file: str | Path) -> list[tuple[str, Mapping[str, Any]]]:
    """Paths of nodes in a file, and their parameters by names with dots.

    Raises OSError or ValueError, in one line with file and key, for what is no parameter file: the middleware's own reader
    waits for pipes, ends processes on deep nesting, and does not name the key.
    """
    content = load_yaml(file, 'parameter file') or {}
    try:
        sections = list(_sections(content))
    except ValueError as error:
        raise ValueError(f'parameter file {file}: {error}, expected NODE: ros__parameters: NAME: VALUE') from error
    for path, parameters in sections:
        for name, value in parameters.items():
            _check_kind(value, f'parameter file {file}: {path} {name} is {shown(value)}, expected')
    return sections


def _check_kind(value: Any, complaint: str) -> None:
    """Raise ValueError that begins with the complaint for a value of no type that parameters have."""
    items = value if isinstance(value, list) else [value]
    if len(kinds := {type(item) for item in items}) > 1 or not kinds <= {bool, int, float, str}:
        raise ValueError(f'{complaint} a truth value, a number, a text, or a list of one of these')
    if int in kinds and not all(-LARGEST_WHOLE - 1 <= number <= LARGEST_WHOLE for number in items):
        raise ValueError(f'{complaint} whole numbers of 64 bits')


def _names(tree: Any, path: str) -> Iterator[tuple[str, Any]]:
    """The branches of a mapping by names. Raises ValueError for what is none."""
    if not isinstance(tree, dict):
        raise ValueError(f'{path or "its content"} is {shown(tree)}')
    for name, branch in tree.items():
        if not isinstance(name, str):
            raise ValueError(f'{path} has the key {shown(name)}'.strip())
        yield name, branch


def _sections(tree: Any, path: str = '') -> Iterator[tuple[str, Mapping[str, Any]]]:
    for name, branch in _names(tree, path):
        if name == 'ros__parameters':
            yield path, dict(_flat(branch or {}, path))
        else:
            yield from _sections(branch, '/'.join([path, *filter(None, name.split('/'))]))


def _flat(tree: Any, path: str, prefix: str = '') -> Iterator[tuple[str, Any]]:
    for name, value in _names(tree, f'{path} {prefix}'.strip()):
        if isinstance(value, dict):
            yield from _flat(value, path, f'{prefix}{name}.')
        else:
            yield prefix + name, value
