"""Pin the packages of the lists *.in in this folder and their dependencies, with hashes, in lock.txt.

Run it in the assembled environment after a change of the lists, and look at the difference before you commit it.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ALONE = HERE / 'ros_tree.in'  # installed without its dependencies
UNWANTED = {
    'lark-parser',  # overwrites files of its successor lark
    'coverage', 'cython', 'mpmath', 'notify2', 'pytest-cov', 'pytest-repeat', 'pytest-rerunfailures', 'sympy',  # unused
}


def main() -> None:
    """Write lock.txt."""
    lists = [path for path in sorted(HERE.glob('*.in')) if path != ALONE]
    pins = resolve([ALONE], '--no-deps') | resolve(lists)
    lines = [f'{name}=={pin}\n' for name, pin in sorted(pins.items()) if name not in UNWANTED]
    (HERE / 'lock.txt').write_text('# made by lock.py from *.in, do not edit\n' + ''.join(lines))


def resolve(lists: list[Path], *options: str) -> dict[str, str]:
    """Resolve dependencies with pip: version and hash by name of the package."""
    command = [sys.executable, '-m', 'pip', 'install', '-q', '--dry-run', '--ignore-installed', '--report=-', *options]
    command += [f'--requirement={path}' for path in lists]
    report = json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)
    pins = {}
    for package in report['install']:
        name = re.sub('[-_.]+', '-', package['metadata']['name']).lower()
        digest = package['download_info']['archive_info']['hashes']['sha256']
        pins[name] = f'{package["metadata"]["version"]} --hash=sha256:{digest}'
    return pins


if __name__ == '__main__':
    main()
