"""Files that ship with a package."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path


def shipped_file(package: str, folder: str, name: str) -> Path:
    """Path of a file in the source tree of a package, or in its share folder where it is installed.

    Parameters:
        package: name of the package.
        folder: folder beside the package's module, such as `models`.
        name: name of the file.

    Raises LookupError when the package is not installed.
    """
    spec = find_spec(package)
    if spec is not None and spec.origin is not None:
        in_source = Path(spec.origin).resolve().parents[1] / folder / name
        if in_source.exists():
            return in_source
    from ament_index_python import get_package_share_directory
    return Path(get_package_share_directory(package), folder, name)
