"""Parameters of a node without the node: its generated struct, filled from parameter files as by ROS 2."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from rclpy.exceptions import ParameterException
from rclpy.parameter import Parameter

from av_common.config_reader import LARGEST_WHOLE
from av_common.files import nearest, shown
from av_common.node import RigNode
from av_common.parameter_files import fits, parameters_for, sections_of
from av_common.parameter_node import check_value


def node_parameters(package: str, node: str, parameter_files: Sequence[str | Path] = (),
                    overrides: Mapping[str, Any] | None = None, namespace: str = '') -> Any:
    """The parameters of a node as the struct that generate_parameter_library makes of its YAML description.

    Parameters:
        package, node: the node is the module `package.nodes.node`.
        parameter_files: later files win over earlier ones. A section counts when its name fits the node's full name.
        overrides: values by names with dots, which win over all files.
        namespace: the node's namespace, which sections of files may name.

    Raises ValueError that names the parameter, OSError for an unreadable file.
    """
    given: dict[str, Any] = {}
    files: dict[str, str] = {}
    for file in parameter_files:
        found = parameters_for(file, '/'.join(['', *filter(None, namespace.split('/')), node]))
        given.update(found)
        files.update(dict.fromkeys(found, f'{file}: '))
    for name, value in (overrides or {}).items():
        given[name], files[name] = value, ''
    node_class = _node_class(package, node)
    generated = getattr(_own_module(f'{package}.nodes.{node}_parameters'), node)
    try:
        parameters = generated.ParamListener(_Declarations(given)).get_params()
        node_class.check_parameters(parameters)
    except (ParameterException, ValueError) as error:
        named = sorted({file for name, file in files.items() if re.search(rf'\b{re.escape(name)}\b', str(error))})
        raise ValueError(f'{"".join(named)}{node}: {_reason(error)}') from error
    return parameters


NODES = '.nodes.'   # in the modules of the suite's nodes
# Of every node: of RigNode, of the updater of its diagnostics, and of rclpy.
COMMON = ('autostart', 'diagnostic_updater.period', 'diagnostic_updater.use_fqn', 'start_type_description_service',
          'use_sim_time')
QOS_OVERRIDES = 'qos_overrides.'    # rclpy's, of any topic


def check_parameter_file(file: str | Path, nodes: Collection[str]) -> list[str]:
    """Raise ValueError for sections of a file that are for none of the nodes, and names or values that their nodes refuse.

    A section of another node of the suite is none of these mistakes; the result tells of it. Raises as `sections_of`, too.

    Parameters:
        file: the file.
        nodes: full names of the nodes that read it; the last part of each is the name of its program.
    """
    modules, mistakes, notes = node_modules(), [], []
    idle = {f'{name.rpartition("/")[0]}/{program}' for name in nodes for program in modules} - set(nodes)
    for path, parameters in sections_of(file):
        meant = [name for name in nodes if fits(path, name)]
        if not meant:
            meant = [name for name in idle if fits(path, name)]
            notes += [f'{path} has no effect, as this node is not started'] if meant else []
        if not meant:
            mistakes.append(f'no node is {path or "without a name"}, the nearest is {_meant_by(path, nodes)}')
            continue
        programs = {modules[node.rpartition('/')[2]] for node in meant}
        known: set[str] = set()
        for module in programs:
            try:
                known |= parameter_names(module, parameters)
            except ValueError as error:
                mistakes.append(f'{path}: {error}')
                known |= parameter_names(module)
        for name in parameters:
            if name not in known and not name.startswith(QOS_OVERRIDES):
                mistakes.append(f'{path} has no parameter {name}, the nearest is {nearest(name, known)}')
    if mistakes:
        raise ValueError(f'parameter file {file}: {"; ".join(mistakes)}')
    return [f'parameter file {file}: {note}' for note in notes]


def node_modules() -> dict[str, str]:
    """Of the suite's nodes that are installed: the module by the name of the program."""
    return {program.name: program.module for program in entry_points(group='console_scripts')
            if program.module.startswith('av_') and NODES in program.module}


def parameter_names(module: str, given: Mapping[str, Any] = MappingProxyType({})) -> frozenset[str]:
    """The names of a node's parameters, those of all nodes among them.

    Parameters:
        module: of the node, which is not imported: some take seconds.
        given: values by names.

    Raises ValueError for a value of another type or out of its bounds.
    """
    name = module.rpartition('.')[2]
    declarations = _Declarations(given)
    try:
        getattr(_own_module(f'{module}_parameters'), name).ParamListener(declarations)
    except ModuleNotFoundError:    # a node without parameters of its own
        pass
    except (ParameterException, ValueError) as error:
        raise ValueError(_reason(error)) from error
    return frozenset({*declarations.declared, *COMMON})


def _reason(error: Exception) -> str:
    """What is wrong with a value, without what rclpy says around it."""
    return re.sub(r'^.*Invalid value set during initialization for parameter \S+: (.*?)(: \S+)?$', r'\1', str(error))


def _meant_by(path: str, nodes: Collection[str]) -> str:
    """The name that was meant by the path of a section that is for none of the nodes."""
    above, _, last = path.rpartition('/')
    program = nearest(last, {name.rpartition('/')[2] for name in nodes})
    written = f'{above}/{program}'
    if any(fits(written, name) for name in nodes):
        return written
    return nearest(path, {name for name in nodes if name.endswith(f'/{program}')})


class _Declarations:
    """The interface of a node that generated code uses: declared parameters take the given values or their defaults.

    Parameters:
        given: values by names with dots; those that are not declared are ignored, as by a node.

    Attributes:
        declared: what was declared, by name.
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        self._given = given
        self.declared: dict[str, Parameter] = {}

    def has_parameter(self, name: str) -> bool:
        """Whether it has been declared."""
        return name in self.declared

    def declare_parameter(self, name: str, default: Any, _descriptor: object) -> None:
        """Take the value given, or the default. Raises ValueError when the value has another type than the default."""
        kind = Parameter.Type.from_parameter_value(default)
        value = self._given.get(name, default)
        if kind in (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY):
            value = _real(value)
        if not kind.check(value) or isinstance(value, bool) != (kind is Parameter.Type.BOOL):  # True is an int
            raise ValueError(f'{name} is {shown(value)}, expected {kind.name.lower()}')
        check_value(name, value)
        self.declared[name] = Parameter(name, kind, value)

    def get_parameter(self, name: str) -> Parameter:
        """The parameter as it was declared."""
        return self.declared[name]

    def add_on_set_parameters_callback(self, _callback: Callable[..., Any]) -> None:
        """Ignore the callback: these parameters never change."""


def _real(value: Any) -> Any:
    """Integers as floats, also in lists; other values unchanged."""
    if isinstance(value, list):
        return [_real(item) for item in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) and abs(value) <= LARGEST_WHOLE else value


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
