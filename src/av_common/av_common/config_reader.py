"""Dataclasses from YAML: type hints are the schema, and an error names file, key and value.

A field may carry bounds in its metadata (`bounded`); a class checks several fields together in `__post_init__`.
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

from av_common.files import one_line, shown
from av_common.yaml_reader import ConfigError as ConfigError
from av_common.yaml_reader import load_yaml, parse_yaml

# Limits of what states none: of numbers, of whole numbers such as seeds, and of the length of lists.
LARGEST = 1e6
LARGEST_WHOLE = 2**63 - 1
LONGEST = 1000


def bounded(default: Any = dataclasses.MISSING, low: float | None = None, high: float | None = None,
            above: float | None = None, choices: Sequence[str] | None = None, longest: int | None = None) -> Any:
    """A dataclass field with bounds for its value, or for each number in it.

    Without `low` and `above`, or without `high`, a number is limited to LARGEST, a whole number to LARGEST_WHOLE.

    Parameters:
        default: the field's default; without one the file must give a value.
        low, high: smallest and largest value.
        above: the value must be larger than this.
        choices: the texts that are allowed.
        longest: largest length of a list; LONGEST where it is not given.
    """
    metadata = {'low': low, 'high': high, 'above': above, 'choices': choices, 'longest': longest}
    return dataclasses.field(default=default, metadata={key: value for key, value in metadata.items()
                                                        if value is not None})


def load(cls: type, path: str | Path) -> Any:
    """Read a YAML file as an instance of the dataclass `cls`. Raises OSError for an unreadable file.

    Raises ConfigError, whose message is `file: key: value and what is expected`.

    Parameters:
        cls: the dataclass.
        path: the file.
    """
    content = load_yaml(path)
    try:
        return read(cls, content, folder=Path(path).expanduser().parent)
    except ConfigError as error:
        raise ConfigError(f'{path}: {error}') from error


def parse(cls: type, text: str, key: str) -> Any:
    """Build an instance of a dataclass from a text in YAML or JSON. Raises ConfigError.

    Parameters:
        cls: the dataclass.
        text: the mapping.
        key: where the text stands, for error messages.
    """
    try:
        content = parse_yaml(text)
    except ConfigError as error:
        raise ConfigError(f'{key}: {error}') from error
    return read(cls, content, key)


def read(cls: type, content: Any, key: str = '', folder: Path = Path()) -> Any:
    """Build an instance of a dataclass from a mapping. Raises ConfigError.

    Parameters:
        cls: the dataclass.
        content: the mapping, as YAML gives it.
        key: its key in the file, for error messages; empty for the whole file.
        folder: the file's folder, to which paths in it are relative.
    """
    if not isinstance(content, dict):
        raise ConfigError(f'{key or "file"}: {shown(content)}, a mapping expected')
    hints = typing.get_type_hints(cls, include_extras=True)
    fields = {field.name: field for field in dataclasses.fields(cls)}
    for name in content:
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
    except (ValueError, TypeError, ArithmeticError, OSError) as error:
        raise ConfigError(f'{key}: {one_line(error)}' if key else one_line(error)) from error


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
        return _value(_alternative(arguments, value), value, place)
    if origin in (tuple, list, Sequence):
        return _sequence(arguments, value, place)
    if dataclasses.is_dataclass(hint):
        return read(typing.cast(type, hint), value, place.key, place.folder)
    if hint is Path and isinstance(value, str):
        return _path(value, place)
    if hint in (int, float):
        return number(value, place.key, hint is int, place.bounds)
    if not isinstance(value, hint):
        raise ConfigError(f'{place.key}: {shown(value)}, {_NAMES.get(hint, hint.__name__)} expected')
    if 'choices' in place.bounds and value not in place.bounds['choices']:
        raise ConfigError(f'{place.key}: {shown(value)}, one of {", ".join(place.bounds["choices"])} expected')
    return value


def _alternative(hints: tuple[Any, ...], value: Any) -> Any:
    """That of several types which a value is read as: a path, a list for a list, else the first."""
    lists = [hint for hint in hints if typing.get_origin(hint) in (tuple, list, Sequence)]
    if Path in hints:
        return Path
    return lists[0] if lists and isinstance(value, list) else hints[0]


def _path(value: str, place: _Place) -> Path:
    try:
        return place.folder / Path(value).expanduser()
    except RuntimeError as error:
        raise ConfigError(f'{place.key}: {shown(value)}: {one_line(error)}') from error


def number(value: Any, key: str, whole: bool = False, bounds: typing.Mapping[str, Any] = types.MappingProxyType({})) -> float:
    """A number of a file, a float unless `whole`. Raises ConfigError.

    Parameters:
        value: as YAML gives it.
        key: its key in the file, for error messages.
        whole: whether it must be an integer.
        bounds: `low`, `high` and `above` as in `bounded`.
    """
    expected = 'a whole number' if whole else 'a number'
    if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
        raise ConfigError(f'{key}: {shown(value)}, {expected} expected')
    if abs(value) > LARGEST_WHOLE or math.isnan(value):
        raise ConfigError(f'{key}: {shown(value)}, {expected}, finite and at most 9.2e18 expected')
    value, largest = (value, LARGEST_WHOLE) if whole else (float(value), LARGEST)
    if 'above' in bounds and value <= bounds['above']:
        raise ConfigError(f'{key}: {value} must be more than {bounds["above"]}')
    low, high = bounds.get('low', bounds.get('above', -largest)), bounds.get('high', largest)
    if value < low:
        raise ConfigError(f'{key}: {value} is below {low}')
    if value > high:
        raise ConfigError(f'{key}: {value} is beyond {high}')
    return value


def _choice(kinds: dict[str, type], value: Any, place: _Place) -> Any:
    kind = value.get('kind') if isinstance(value, dict) else None
    if not isinstance(kind, str) or kind not in kinds:
        raise ConfigError(f'{place.key}.kind: {shown(kind)}, one of {", ".join(kinds)} expected')
    rest = {name: item for name, item in value.items() if name != 'kind'}
    return read(kinds[kind], rest, place.key, place.folder)


def _sequence(arguments: tuple, value: Any, place: _Place) -> tuple:
    if not isinstance(value, list):
        raise ConfigError(f'{place.key}: {shown(value)}, a list expected')
    longest = place.bounds.get('longest', LONGEST)
    if len(value) > longest:
        raise ConfigError(f'{place.key}: {len(value)} entries, at most {longest} expected')
    if len(arguments) == 1 or arguments[-1] is Ellipsis:
        arguments = arguments[:1] * len(value)
    if len(value) != len(arguments):
        raise ConfigError(f'{place.key}: {shown(value)}, a list of {len(arguments)} expected')
    return tuple(_value(hint, item, dataclasses.replace(place, key=f'{place.key}[{number}]'))
                 for number, (hint, item) in enumerate(zip(arguments, value, strict=True)))


_NAMES = {str: 'a text', bool: 'true or false', Path: 'a file name'}


def _join(key: str, name: Any) -> str:
    text = one_line(name) if isinstance(name, str) and len(name) < 60 else shown(name)
    return f'{key}.{text}' if key else text
