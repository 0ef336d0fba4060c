"""YAML with limits: what a file of a few bytes can make of itself stays small, and errors are one line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from av_common.files import one_line, read_text

DEPTH = 50          # levels of nesting, far from the 1000 of Python's recursion; scenarios have 6
NODES = 100_000     # values, which take a second to read
DIGITS = 40         # characters of a number: float64 needs 24 (-1.7976931348623157e+308)
_PARSER: Any = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)  # ten times as fast, where PyYAML has it


class ConfigError(ValueError):
    """Text that is no YAML, exceeds a limit, or has a wrong key or value; the message is one line with the place."""


def load_yaml(path: str | Path, kind: str = '') -> Any:
    """The content of a YAML file. Raises OSError or ConfigError that name the file.

    Parameters:
        path: the file.
        kind: what the file should be, for the message.
    """
    text = read_text(path, kind=kind)
    try:
        return parse_yaml(text)
    except ConfigError as error:
        raise ConfigError(f'{kind} {path}: {error}'.strip()) from error


def parse_yaml(text: str) -> Any:
    """The content of a YAML document. Raises ConfigError.

    What looks like a number or a date but is none, such as one of 400 digits, stays a text.
    """
    try:
        _check(yaml.parse(text, Loader=_PARSER))
        return yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f' in line {mark.line + 1}' if mark else ''
        raise ConfigError(f'not YAML{place}: {one_line(error.problem or error.context)}') from error
    except (yaml.YAMLError, RecursionError, TypeError, ValueError) as error:
        raise error if isinstance(error, ConfigError) else ConfigError(f'not YAML: {one_line(error)}') from error


class _Loader(_PARSER):
    """Like `SafeLoader`, but a scalar that cannot be converted to its apparent type stays a text, and no key is given twice."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """See PyYAML, which would take the last of two values. Raises ConfigError."""
        known = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in known:
                raise ConfigError(f'line {key.start_mark.line + 1}: {key.value[:DIGITS]} is given twice')
            known.add(key.value)
        return super().construct_mapping(node, deep)


def _number_or_text(loader: Any, node: yaml.ScalarNode) -> Any:
    if len(node.value) > DIGITS:
        return node.value
    try:
        return yaml.SafeLoader.yaml_constructors[node.tag](loader, node)
    except (ValueError, IndexError, AttributeError):
        return node.value


# As YAML 1.2 and the parameter files of ROS have them, and PyYAML has not: 1e-3, 1.5e3, -.5
_Loader.add_implicit_resolver('tag:yaml.org,2002:float', re.compile(r'[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$'),
                              list('-+.0123456789'))
for _kind in ('int', 'float', 'timestamp'):
    _Loader.add_constructor(f'tag:yaml.org,2002:{_kind}', _number_or_text)


def _check(events: Iterator[Any]) -> None:
    """Raise ConfigError for too many values, deep nesting, and aliases, by which few bytes become a large document."""
    depth = 0
    for number, event in enumerate(events):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        line = f'line {event.start_mark.line + 1}'
        if isinstance(event, yaml.AliasEvent):
            raise ConfigError(f'{line}: the alias *{event.anchor}, expected the value itself')
        if depth > DEPTH:
            raise ConfigError(f'{line}: more than {DEPTH} levels of nesting')
        if number > NODES:
            raise ConfigError(f'{line}: more than {NODES} values')
