"""Numeric constants of modules, and imports under which one of them has another value."""

from __future__ import annotations

import ast
import builtins
import importlib.machinery
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple


class Constant(NamedTuple):
    """A numeric constant.

    Parameters:
        module: its full name.
        name: of the constant.
        value: as written.
    """

    module: str
    name: str
    value: str


def constants(package: Path) -> list[Constant]:
    """The numeric constants at the top of all modules of a package: numbers, tuples and expressions of them, no tables.

    Parameters:
        package: its folder, named as it is imported.
    """
    found = []
    for file in sorted(package.rglob('*.py')):
        module = '.'.join((package.name, *file.relative_to(package).with_suffix('').parts))
        found += [Constant(module, target.id, ast.unparse(values[k]))
                  for values, targets in _assigned(ast.parse(file.read_text())) for k, target in enumerate(targets)
                  if isinstance(target, ast.Name) and target.id.isupper() and _is_numeric(values[k])]
    return found


def _assigned(tree: ast.Module) -> Iterator[tuple[list[ast.expr], list[ast.expr]]]:
    """Values and names of the assignments at the top of a module; those of a tuple one by one, to be replaced in place."""
    for statement in tree.body:
        if isinstance(statement, ast.Assign) and len(statement.targets) == 1:
            target = statement.targets[0]
            if isinstance(target, ast.Tuple) and isinstance(statement.value, ast.Tuple):
                yield statement.value.elts, target.elts
            else:
                values = [statement.value]
                yield values, [target]
                statement.value = values[0]
        elif isinstance(statement, ast.AnnAssign) and statement.value is not None:
            values = [statement.value]
            yield values, [statement.target]
            statement.value = values[0]


def _is_numeric(value: ast.expr) -> bool:
    """Whether a value is made of numbers, and no table or class."""
    numbers = [part.value for part in ast.walk(value) if isinstance(part, ast.Constant)]
    return (not isinstance(value, (ast.Dict, ast.DictComp, ast.Set)) and any(type(one) in (int, float) for one in numbers)
            and not any(isinstance(one, str) for one in numbers))


def scale(constant: Constant, factor: float) -> None:
    """Let a constant be `factor` times as large in every module that is imported from now on.

    Parameters:
        constant: of a module that has not been imported yet.
        factor: integers are rounded, to 1 at least.
    """
    def scaled(value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(map(scaled, value))
        return max(1, round(value * factor)) if isinstance(value, int) else value * factor

    code_of = importlib.machinery.SourceFileLoader.get_code

    def get_code(loader: importlib.machinery.SourceFileLoader, module: str) -> Any:
        if module != constant.module:
            return code_of(loader, module)
        tree = ast.parse(loader.get_data(loader.path))
        for values, targets in _assigned(tree):
            for k, target in enumerate(targets):
                if isinstance(target, ast.Name) and target.id == constant.name:
                    values[k] = ast.Call(ast.Name('__scaled', ast.Load()), [values[k]], [])
        return compile(ast.fix_missing_locations(tree), loader.path, 'exec')

    setattr(builtins, '__scaled', scaled)
    importlib.machinery.SourceFileLoader.get_code = get_code  # type: ignore[assignment,method-assign]
