"""Python packages that only some people want."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType


def load_optional(modules: Sequence[str], package: str, purpose: str) -> ModuleType:
    """The first of some modules, all of which are imported. Raises ImportError that names what to install.

    Parameters:
        modules: names of modules of the package.
        package: its name for pip.
        purpose: what needs it.
    """
    try:
        for module in modules:
            import_module(module)
    except ImportError as error:
        raise ImportError(f'{purpose} needs the Python package {package}: pip install {package} ({error})') from error
    return sys.modules[modules[0]]
