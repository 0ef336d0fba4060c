"""A node's parameters without the node: defaults of its YAML description, changed by parameter files as ROS 2 reads them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import yaml
from generate_parameter_library_py.python_validators import ParameterValidators

KINDS = {'double': float, 'int': int, 'bool': bool, 'string': str}


def node_parameters(package: str, node: str, parameter_files: Sequence[str | Path] = (),
                    overrides: Mapping[str, Any] | None = None, namespace: str = '') -> SimpleNamespace:
    """The parameters of `node` as the generated struct has them, nested names as nested attributes.

    Later files win over earlier ones, `overrides` over all. Raises ValueError naming the parameter, or OSError.
    """
    text = files(f'{package}.nodes').joinpath(f'{node}_parameters.yaml').read_text(encoding='utf-8')
    described = dict(_described(yaml.safe_load(text)[node]))
    values = {name: description.get('default_value') for name, description in described.items()}
    full_name = [part for part in f'{namespace}/{node}'.split('/') if part]
    for file in parameter_files:
        given = _values_of(full_name, Path(file))
        values.update((name, value) for name, value in given.items() if name in described)
    values.update(overrides or {})
    struct = SimpleNamespace()
    for name, value in values.items():
        *groups, last = name.split('.')
        target = struct
        for group in groups:
            target.__dict__.setdefault(group, SimpleNamespace())
            target = getattr(target, group)
        setattr(target, last, _checked(f'{node}: {name}', value, described[name]))
    return struct


def _described(tree: Mapping[str, Any], prefix: str = '') -> Iterator[tuple[str, dict]]:
    """Names with dots and descriptions of all parameters of a tree of groups."""
    for name, branch in tree.items():
        if isinstance(branch.get('type'), str):
            yield prefix + name, branch
        else:
            yield from _described(branch, f'{prefix}{name}.')


def _values_of(node: Sequence[str], file: Path) -> dict[str, Any]:
    """What a parameter file says of a node, by names with dots."""
    try:
        content = yaml.safe_load(file.read_text(encoding='utf-8')) or {}
        found: dict[str, Any] = {}
        for pattern, parameters in _sections(content):
            if _matches(pattern, node):
                found.update(_flat(parameters))
    except (yaml.YAMLError, AttributeError) as error:
        raise ValueError(f'parameter file {file}: expected NODE: ros__parameters: NAME: VALUE ({error})') from error
    return found


def _sections(tree: Mapping[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], dict]]:
    for name, branch in tree.items():
        if name == 'ros__parameters':
            yield path, branch or {}
        else:
            yield from _sections(branch, (*path, *(part for part in name.split('/') if part)))


def _matches(pattern: Sequence[str], name: Sequence[str]) -> bool:
    """Whether a node's name fits a pattern, in which * stands for one part and ** for any number of them."""
    if not pattern or not name:
        return not name and all(part == '**' for part in pattern)
    if pattern[0] == '**':
        return _matches(pattern[1:], name) or _matches(pattern, name[1:])
    return pattern[0] in ('*', name[0]) and _matches(pattern[1:], name[1:])


def _flat(tree: Mapping[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from _flat(value, f'{prefix}{name}.')
        else:
            yield prefix + name, value


def _checked(name: str, value: Any, description: Mapping[str, Any]) -> Any:
    """The value in the type described. Raises ValueError when it has another or breaks a rule."""
    kind = KINDS[description['type'].removesuffix('_array')]
    is_list = description['type'].endswith('_array')
    values = value if is_list and isinstance(value, list) else [value]
    whole_as_real = (float, int) if kind is float else kind
    if isinstance(value, list) != is_list or not all(
            isinstance(v, whole_as_real) and isinstance(v, bool) == (kind is bool) for v in values):
        raise ValueError(f'{name} is {value!r}, expected {description["type"]}')
    result = [kind(v) for v in values] if is_list else kind(value)
    parameter = SimpleNamespace(name=name, value=result)
    for rule, arguments in (description.get('validation') or {}).items():
        problem = getattr(ParameterValidators, rule.removesuffix('<>'))(parameter, *arguments)
        if problem:
            raise ValueError(problem)
    return result
