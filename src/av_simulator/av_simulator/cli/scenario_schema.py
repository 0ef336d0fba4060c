"""Prints the JSON Schema of scenario files: `ros2 run av_simulator scenario_schema > config/scenario.schema.json`.

For editors and checks, in draft 2020-12, from the type hints that read the files.
"""

from __future__ import annotations

import dataclasses
import json
import types
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from av_common.config_reader import LARGEST, LARGEST_WHOLE, LONGEST
from av_simulator.scenario import Scenario

_TYPES = {float: 'number', int: 'integer', str: 'string', bool: 'boolean', Path: 'string'}
_BOUNDS = {'low': 'minimum', 'high': 'maximum', 'above': 'exclusiveMinimum', 'choices': 'enum'}


def schema(cls: type) -> dict[str, Any]:
    """The schema of a file that `config_reader.load` reads as the dataclass `cls`."""
    return {'$schema': 'https://json-schema.org/draft/2020-12/schema', 'title': cls.__name__, **_mapping(cls)}


def _mapping(cls: type, kind: str | None = None) -> dict[str, Any]:
    hints = typing.get_type_hints(cls, include_extras=True)
    fields = {field.name: field for field in dataclasses.fields(cls)}
    properties = {name: _value(hints[name], field.metadata) for name, field in fields.items()}
    required = [name for name, field in fields.items()
                if field.default is field.default_factory is dataclasses.MISSING]
    if kind is not None:
        properties, required = {'kind': {'const': kind}, **properties}, ['kind', *required]
    return {'type': 'object', 'properties': properties, 'required': required, 'additionalProperties': False}


def _value(hint: Any, bounds: typing.Mapping[str, Any]) -> dict[str, Any]:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        return {'oneOf': [_mapping(cls, kind) for kind, cls in arguments[1].items()]}
    if origin in (typing.Union, types.UnionType):
        options = [{'type': 'null'} if option is type(None) else _value(option, bounds) for option in arguments]
        return {'anyOf': options}
    if origin in (tuple, list, Sequence):
        if len(arguments) == 1 or arguments[-1] is Ellipsis:
            return {'type': 'array', 'items': _value(arguments[0], bounds), 'maxItems': bounds.get('longest', LONGEST)}
        return {'type': 'array', 'prefixItems': [_value(item, bounds) for item in arguments],
                'minItems': len(arguments), 'maxItems': len(arguments)}
    if dataclasses.is_dataclass(hint):
        return _mapping(typing.cast(type, hint))
    return {'type': _TYPES[hint], **_limits(hint, bounds)}


def _limits(hint: Any, bounds: typing.Mapping[str, Any]) -> dict[str, Any]:
    found = {_BOUNDS[name]: bound for name, bound in bounds.items() if name in _BOUNDS}
    if hint in (int, float):
        largest = LARGEST_WHOLE if hint is int else LARGEST
        lowest = {} if 'above' in bounds else {'minimum': -largest}
        found = {**lowest, 'maximum': largest, **found}
    return found


def main() -> None:
    """Print the schema."""
    print(json.dumps(schema(Scenario), indent=1))
