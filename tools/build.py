"""Builds the packages of src/ that have changed since they were built: `python3 tools/build.py`, with ROS 2 set up.

With --symlink-install the modules of a built package are those of the source tree: a changed module needs no build. Built are
packages whose list of files, or a file other than a module, differs from when they were built, and all of them in another
environment.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
BUILT = PROJECT / 'build' / 'built.json'
# Folders and files that no package installs, or that a build itself writes.
IGNORED = {'test', '__pycache__', '.pytest_cache', '.hypothesis'}
GENERATED = '_parameters.py'


def digest(package: Path) -> str:
    """Fingerprint of what a build of a package depends on.

    Parameters:
        package: its folder.
    """
    found = hashlib.sha256(f'{PROJECT} {sys.version} {os.environ.get("ROS_DISTRO")}'.encode())
    for folder, folders, files in os.walk(package, followlinks=True):
        folders[:] = sorted(name for name in folders if name not in IGNORED and not name.endswith('.egg-info'))
        for name in sorted(files):
            if name.endswith((GENERATED, '.pyc')):
                continue
            file = Path(folder, name)
            found.update(str(file.relative_to(package)).encode())
            if file.suffix != '.py' or name == 'setup.py':
                found.update(hashlib.sha256(file.read_bytes()).digest())
    return found.hexdigest()


def main() -> int:
    """Build what has changed, and note what was built; returns the exit code of colcon."""
    now = {folder.parent.name: digest(folder.parent) for folder in sorted(PROJECT.glob('src/*/package.xml'))}
    before = json.loads(BUILT.read_text()) if BUILT.exists() else {}
    changed = [name for name, value in now.items()
               if before.get(name) != value or not (PROJECT / 'install' / name / 'share' / name / 'package.xml').exists()]
    if not changed:
        print(f'build: {len(now)} packages are up to date')
        return 0
    # Of messages; colcon itself would wait for a low load.
    environment = {**os.environ, 'MAKEFLAGS': f'-j{os.cpu_count()}'}
    code = subprocess.run(['colcon', 'build', '--symlink-install', '--packages-select', *changed],
                          cwd=PROJECT, env=environment, check=False).returncode
    if not code:
        BUILT.write_text(json.dumps(now, indent=1))
    return code


if __name__ == '__main__':
    sys.exit(main())
