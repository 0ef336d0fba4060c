"""Check that each locked Python dependency has a wheel for another processor: `python3 tools/distributions/wheels.py`.

pip resolves lock.txt as that processor would, from metadata alone. The wheels from which ROS itself is assembled exist for
x86-64 only: elsewhere ROS is installed by apt. The exit code is 1 where a wheel is missing.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

LOCK = Path(__file__).resolve().parents[1] / 'ros_env/lock.txt'
ROS = ('ros-', 'isaacsim-', 'empy==')  # what ROS is assembled from, and the templates' language of its generators
GLIBC = range(17, 40)  # manylinux tags of these minor versions fit Ubuntu 24.04


def missing(requirements: list[str], machine: str, python: str) -> list[str]:
    """The requirements without a wheel.

    Parameters:
        requirements: such as numpy==2.3.5.
        machine: processor, as wheels name it.
        python: version, such as 3.12.
    """
    found: list[str] = []
    platforms = [f'--platform={tag}' for tag in (*(f'manylinux_2_{minor}_{machine}' for minor in GLIBC),
                                                 f'manylinux2014_{machine}')]
    while True:
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, '-m', 'pip', 'install', '-q', '--dry-run', '--ignore-installed', '--no-deps',
                       '--use-feature=fast-deps', '--ignore-requires-python', f'--target={folder}',
                       '--only-binary=:all:', '--implementation=cp',
                       f'--python-version={python}', *platforms]
            done = subprocess.run([*command, *requirements], capture_output=True, text=True, check=False)
        if not done.returncode:
            return found
        match = re.search(r'No matching distribution found for (\S+)', done.stderr)
        if match is None:
            raise RuntimeError(done.stderr)
        found.append(match[1])
        requirements = [name for name in requirements if name != match[1]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what is missing; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--machine', default='aarch64', help='processor (%(default)s)')
    parser.add_argument('--python', default='3.12', help='version (%(default)s)')
    options = parser.parse_args(arguments)
    lines = [line.split()[0] for line in LOCK.read_text().splitlines() if '==' in line and not line.startswith(ROS)]
    absent = missing(lines, options.machine, options.python)
    print(f'{len(lines) - len(absent)} of {len(lines)} locked dependencies have a wheel for {options.machine}, '
          f'Python {options.python}')
    for name in absent:
        print(f'  none: {name}')
    return int(bool(absent))


if __name__ == '__main__':
    sys.exit(main())
