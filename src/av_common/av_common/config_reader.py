"""Dataclasses from YAML: type hints are the schema, and an error names file, key and value.

A field may carry bounds in its metadata (`bounded`); a class checks several fields together in `__post_init__`.
Old keys are refused with a message that names the new key, where a class lists both in `RENAMED_KEYS`.
`Annotated[Any, {'circle': Circle, ...}]` is a choice of dataclasses by the mapping's key `kind`.
Paths are relative to the file that contains them.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml


class ConfigError(ValueError):
    """A configuration file with a wrong key or value; the message is `file: key: value and what is expected`."""


def bounded(default: Any = dataclasses.MISSING, low: float | None = None, high: float | None = None,
            above: float | None = None, choices: Sequence[str] | None = None) -> Any:
    """A dataclass field with bounds for its value, or for each number in it.

    Parameters:
        default: the field's default; without one the file must give a value.
        low, high: smallest and largest value.
        above: the value must be larger than this.
        choices: the texts that are allowed.
    """
    metadata = {'low': low, 'high': high, 'above': above, 'choices': choices}
    return dataclasses.field(default=default, metadata={key: value for key, value in metadata.items()
                                                        if value is not None})


def load(cls: type, path: str | Path) -> Any:
    """Read a YAML file as an instance of the dataclass `cls`. Raises ConfigError, or OSError for an unreadable file."""
    path = Path(path)
    try:
        content = yaml.safe_load(path.read_text())
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f'{path}: not YAML: {error}') from error
    try:
        return read(cls, content, folder=path.parent)
    except ConfigError as error:
        raise ConfigError(f'{path}: {error}') from error


def read(cls: type, content: Any, key: str = '', folder: Path = Path()) -> Any:
    """Build an instance of a dataclass from a mapping. Raises ConfigError.

    Parameters:
        cls: the dataclass.
        content: the mapping, as YAML gives it.
        key: its key in the file, for error messages; empty for the whole file.
        folder: the file's folder, to which paths in it are relative.
    """
    if not isinstance(content, dict):
        raise ConfigError(f'{key or "file"}: {content!r}, a mapping expected')
    hints = typing.get_type_hints(cls, include_extras=True)
    fields = settable_fields(cls)
    renamed: dict[str, str] = getattr(cls, 'RENAMED_KEYS', {})
    for name in content:
        if name in renamed:
            raise ConfigError(f'{_join(key, name)}: this key is now named {renamed[name]}')
        if name not in fields:
            raise ConfigError(f'{_join(key, name)}: unknown key, one of {", ".join(fields)} expected')
    for name, field in fields.items():
        if name not in content and field.default is field.default_factory is dataclasses.MISSING:
            raise ConfigError(f'{_join(key, name)}: missing')
    values = {name: _value(hints[name], value, _Place(_join(key, name), folder, fields[name].metadata))
              for name, value in content.items()}
    try:
        return cls(**values)
    except ConfigError:
        raise
    except (ValueError, OSError) as error:
        raise ConfigError(f'{key}: {error}' if key else str(error)) from error


def settable_fields(cls: type) -> dict[str, dataclasses.Field]:
    """The fields of a dataclass that a file may set: all but functions."""
    hints = typing.get_type_hints(cls, include_extras=True)
    return {field.name: field for field in dataclasses.fields(cls) if not _is_callable(hints[field.name])}


@dataclasses.dataclass(frozen=True)
class _Place:
    """Key of a value, folder of its file, and bounds of the value."""

    key: str
    folder: Path
    bounds: typing.Mapping[str, Any]


def _value(hint: Any, value: Any, place: _Place) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        return _choice(arguments[1], value, place)
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        return _value(Path if Path in arguments else arguments[0], value, place)
    if origin in (tuple, list, Sequence):
        return _sequence(arguments, value, place)
    if dataclasses.is_dataclass(hint):
        reader = getattr(hint, 'from_yaml', None)
        return reader(value, place.key) if reader else read(typing.cast(type, hint), value, place.key, place.folder)
    if hint is Path and isinstance(value, str):
        return place.folder / Path(value).expanduser()
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, hint) or (hint is int and isinstance(value, bool)):
        raise ConfigError(f'{place.key}: {value!r}, {_NAMES.get(hint, hint.__name__)} expected')
    _check(value, place)
    return value


def _choice(kinds: dict[str, type], value: Any, place: _Place) -> Any:
    kind = value.get('kind') if isinstance(value, dict) else None
    if kind not in kinds:
        raise ConfigError(f'{place.key}.kind: {kind!r}, one of {", ".join(kinds)} expected')
    rest = {name: item for name, item in value.items() if name != 'kind'}
    return read(kinds[kind], rest, place.key, place.folder)


def _sequence(arguments: tuple, value: Any, place: _Place) -> tuple:
    if not isinstance(value, list):
        raise ConfigError(f'{place.key}: {value!r}, a list expected')
    if len(arguments) == 1 or arguments[-1] is Ellipsis:
        arguments = arguments[:1] * len(value)
    if len(value) != len(arguments):
        raise ConfigError(f'{place.key}: {value!r}, a list of {len(arguments)} expected')
    return tuple(_value(hint, item, dataclasses.replace(place, key=f'{place.key}[{number}]'))
                 for number, (hint, item) in enumerate(zip(arguments, value, strict=True)))


_NAMES = {float: 'a number', int: 'a whole number', str: 'a text', bool: 'true or false', Path: 'a file name'}


def _check(value: Any, place: _Place) -> None:
    key, bounds = place.key, place.bounds
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f'{key}: {value}, a finite number expected')
    if 'low' in bounds and value < bounds['low']:
        raise ConfigError(f'{key}: {value} is below {bounds["low"]}')
    if 'high' in bounds and value > bounds['high']:
        raise ConfigError(f'{key}: {value} is beyond {bounds["high"]}')
    if 'above' in bounds and value <= bounds['above']:
        raise ConfigError(f'{key}: {value} must be more than {bounds["above"]}')
    if 'choices' in bounds and value not in bounds['choices']:
        raise ConfigError(f'{key}: {value!r}, one of {", ".join(bounds["choices"])} expected')


def _is_callable(hint: Any) -> bool:
    """Whether a hint is a function, or `Callable[...] | None`: such fields cannot be set by a file."""
    candidates = typing.get_args(hint) if typing.get_origin(hint) in (typing.Union, types.UnionType) else (hint,)
    return any(typing.get_origin(candidate) is typing.get_origin(typing.Callable[[], None]) for candidate in candidates)


def _join(key: str, name: Any) -> str:
    return f'{key}.{name}' if key else str(name)
