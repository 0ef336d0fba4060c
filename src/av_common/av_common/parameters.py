"""Parameters of a node without the node: its generated struct, filled from parameter files as by ROS 2."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from types import ModuleType
from typing import Any

from rclpy.exceptions import ParameterException
from rclpy.parameter import PARAMETER_SEPARATOR_STRING, Parameter

from av_common.files import shown
from av_common.node import RenamedParameterError, RigNode
from av_common.parameter_rules import ParameterError, check_together, check_value
from av_common.yaml_reader import load_yaml


def node_parameters(package: str, node: str, parameter_files: Sequence[str | Path] = (),
                    overrides: Mapping[str, Any] | None = None, namespace: str = '') -> Any:
    """The parameters of a node as the struct that generate_parameter_library makes of its YAML description.

    Parameters:
        package, node: the node is the module `package.nodes.node`.
        parameter_files: later files win over earlier ones. A section counts when its name fits the node's full name.
        overrides: values by names with dots, which win over all files.
        namespace: the node's namespace, which sections of files may name.

    Raises ValueError naming the parameter, RenamedParameterError for an old name, OSError for an unreadable file.
    """
    given: dict[str, Any] = {}
    files: dict[str, str] = {}
    for file in parameter_files:
        found = _read(Path(file), '/'.join(['', *filter(None, namespace.split('/')), node]))
        given.update(found)
        files.update(dict.fromkeys(found, f'{file}: '))
    for name, value in (overrides or {}).items():
        given[name], files[name] = value, ''
    node_class = _node_class(package, node)
    for old, new in node_class.RENAMED_PARAMETERS.items():
        if old in given:
            raise RenamedParameterError(old, new)
    generated = getattr(_own_module(f'{package}.nodes.{node}_parameters'), node)
    try:
        parameters = generated.ParamListener(_Declarations(node, given, files)).get_params()
        check_together(node_class.check_parameters, parameters)
    except (ParameterException, ParameterError) as error:
        named = sorted({file for name, file in files.items() if name in str(error)})
        raise ValueError(f'{"".join(named)}{node}: {error}') from error
    return parameters


def check_parameter_file(file: str | Path) -> None:
    """Raise OSError or ValueError, in one line with file and key, for what is no parameter file.

    The middleware's own reader waits for pipes, ends processes on deep nesting, and does not name the key.

    Parameters:
        file: the file; whether a node has these parameters is not looked at.
    """
    for node, parameters in _sections_of(Path(file)):
        for name, value in parameters.items():
            items = value if isinstance(value, list) else [value]
            if len(kinds := {type(item) for item in items}) > 1 or not kinds <= {bool, int, float, str}:
                raise ValueError(f'parameter file {file}: {node} {name} is {shown(value)}, expected a truth value, a number, a '
                                 'text, or a list of one of these')
            if int in kinds and not all(-LARGEST <= number < LARGEST for number in items):
                raise ValueError(f'parameter file {file}: {node} {name} is {shown(value)}, expected whole numbers of 64 bits')


LARGEST = 2**63     # of the integers of parameters


class _Declarations:
    """The interface of a node that generated code uses: declared parameters take the given values or their defaults.

    Parameters:
        node: the node's name, for error messages.
        given: values by names with dots; those that are not declared are ignored, as by a node.
        files: prefix of error messages on each of them.
    """

    def __init__(self, node: str, given: Mapping[str, Any], files: Mapping[str, str]) -> None:
        self._node, self._given, self._files = node, given, files
        self._declared: dict[str, Parameter] = {}

    def has_parameter(self, name: str) -> bool:
        """Whether it has been declared."""
        return name in self._declared

    def declare_parameter(self, name: str, default: Any, _descriptor: object) -> None:
        """Take the value given, or the default. Raises ValueError when the value has another type than the default."""
        kind = Parameter.Type.from_parameter_value(default)
        value = self._given.get(name, default)
        if kind in (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY):
            value = _real(value)
        if not kind.check(value) or isinstance(value, bool) != (kind is Parameter.Type.BOOL):  # True is an int
            raise ValueError(f'{self._files.get(name, "")}{self._node}: {name} is {shown(value)}, expected {kind.name.lower()}')
        check_value(name, value)
        self._declared[name] = Parameter(name, kind, value)

    def get_parameter(self, name: str) -> Parameter:
        """The parameter as it was declared."""
        return self._declared[name]

    def add_on_set_parameters_callback(self, _callback: Callable[..., Any]) -> None:
        """Ignore the callback: these parameters never change."""


def _real(value: Any) -> Any:
    """Integers as floats, also in lists; other values unchanged."""
    if isinstance(value, list):
        return [_real(item) for item in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) and abs(value) < LARGEST else value


def _own_module(name: str) -> ModuleType:
    """A module that nobody else has: generated structs keep nested parameters in their class, which all calls would share."""
    specification = find_spec(name)
    if specification is None or specification.loader is None:
        raise ModuleNotFoundError(f'no module {name}')
    module = module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def _node_class(package: str, node: str) -> type[RigNode]:
    module = import_module(f'{package}.nodes.{node}')
    return next(item for item in vars(module).values()
                if isinstance(item, type) and issubclass(item, RigNode) and item.__module__ == module.__name__)


def _read(file: Path, node: str) -> dict[str, Any]:
    """Parameters that a file sets for the node with this full name, by names with dots.

    `rclpy.parameter.parameter_dict_from_yaml_file` finds neither the nodes of `/*/node`, `/**/namespace/node` and
    `namespace: node:`, nor those of `/**/node` without a namespace, and reads '1' in quotes as a number.
    """
    return {name: value for path, parameters in _sections_of(file) if re.fullmatch(_pattern(path), node)
            for name, value in parameters.items()}


def _sections_of(file: Path) -> list[tuple[str, Mapping[str, Any]]]:
    """Paths of nodes in a file, and their parameters by names with dots. Raises OSError or ValueError with file and key."""
    try:
        return list(_sections(load_yaml(file, 'parameter file') or {}))
    except _StructureError as error:
        raise ValueError(f'parameter file {file}: {error}, expected NODE: ros__parameters: NAME: VALUE') from error


class _StructureError(ValueError):
    """A part of a parameter file that is no mapping by names."""


def _names(tree: Any, path: str) -> Iterator[tuple[str, Any]]:
    if not isinstance(tree, dict):
        raise _StructureError(f'{path or "its content"} is {shown(tree)}')
    for name, branch in tree.items():
        if not isinstance(name, str):
            raise _StructureError(f'{path} has the key {shown(name)}'.strip())
        yield name, branch


def _sections(tree: Any, path: str = '') -> Iterator[tuple[str, Mapping[str, Any]]]:
    for name, branch in _names(tree, path):
        if name == 'ros__parameters':
            yield path, dict(_flat(branch or {}, path))
        else:
            yield from _sections(branch, '/'.join([path, *filter(None, name.split('/'))]))


def _pattern(path: str) -> str:
    """A regular expression of the full names of the nodes of a path; * is one name, ** any number."""
    wild = {'*': '/[^/]+', '**': '(/[^/]+)*'}
    return ''.join(wild.get(part, '/' + re.escape(part)) for part in path.split('/')[1:])


def _flat(tree: Any, path: str, prefix: str = '') -> Iterator[tuple[str, Any]]:
    for name, value in _names(tree, f'{path} {prefix}'.strip()):
        if isinstance(value, dict):
            yield from _flat(value, path, prefix + name + PARAMETER_SEPARATOR_STRING)
        else:
            yield prefix + name, value
