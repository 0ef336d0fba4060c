"""Import every package and run the examples with each distribution's Python and libraries: `make distributions`.

Of a distribution only Python is emulated, in a virtual environment of its own: the versions that Ubuntu packages, and of
rosdep's pip keys what pip takes for that Python. ROS itself, which is not compiled for that Python here, is replaced by empty
modules. Needs the interpreters (such as pyenv's) and, once, 0.4 GB from the package index for each distribution.
"""

from __future__ import annotations

import argparse
import importlib
import os
import pkgutil
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

PROJECT = Path(__file__).resolve().parents[2]
# What Ubuntu packages, as the package index names it; or the next one with a wheel.
UBUNTU = {
    'jammy': ('3.10', 'numpy==1.26.4 scipy==1.13.1 opencv-contrib-python-headless==4.5.4.60 matplotlib==3.5.1 h5py==3.6.0 '
                      'soundfile==0.10.3.post1 psutil==5.9.0 pyyaml==6.0 transforms3d==0.4.1'),
    'noble': ('3.12', 'numpy==1.26.4 scipy==1.11.4 opencv-contrib-python-headless==4.6.0.66 matplotlib==3.8.0 h5py==3.10.0 '
                      'soundfile==0.12.1 psutil==5.9.8 pyyaml==6.0.1 transforms3d==0.4.1'),
}
CONSTRAINTS = {'jammy': PROJECT / 'tools/distributions/humble.txt'}
# rosdep's pip keys, and what requirements.txt lists for the robot's packages.
BY_PIP = ('onnxruntime', 'mujoco', 'rosbags', 'mcap', 'sounddevice', 'pyrealsense2', 'websockets>=13')
MOST_SHOWN = 10
# Of ROS, built with it, or optional.
ROS = ('ament_index_python', 'av_interfaces', 'builtin_interfaces', 'diagnostic_msgs', 'diagnostic_updater',
       'generate_parameter_library_py', 'geometry_msgs', 'launch', 'launch_ros', 'lifecycle_msgs', 'mcap_ros2', 'nav_msgs',
       'px4_msgs', 'rcl_interfaces', 'rclpy', 'rosgraph_msgs', 'rosidl_runtime_py', 'sensor_msgs', 'std_msgs', 'std_srvs',
       'tf2_msgs', 'tf2_ros', 'vision_msgs', 'visualization_msgs', 'audio_common_msgs', 'sapient_msg', 'google')


class Anything(type):
    """Of a class that stands in for any name of ROS: each of its attributes is such a class again."""

    def __getattr__(cls, name: str) -> Any:
        if name.startswith('__'):
            raise AttributeError(name)
        return Anything(name, (Stand,), {})

    def __or__(cls, other: object) -> Any:
        return cls

    def __iter__(cls) -> Iterator[object]:
        return iter(())


class Stand(metaclass=Anything):
    """Takes any arguments."""

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def __getattr__(self, name: str) -> Any:
        return getattr(Stand, name)

    def __bytes__(self) -> bytes:
        return b''

    def __fspath__(self) -> str:
        return str(PROJECT)  # a package's share folder has config/ and launch/ in it


class NoRos(MetaPathFinder, Loader):
    """Finder of modules that stand in for ROS and for modules that a build generates."""

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """See `importlib.abc.MetaPathFinder`."""
        found = name.split('.')[0] in ROS or name.endswith('_parameters')
        return ModuleSpec(name, self, is_package=True) if found else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """See `importlib.abc.Loader`."""
        module = ModuleType(spec.name)
        module.__path__ = []
        module.__getattr__ = lambda name: getattr(Stand, name)  # type: ignore[method-assign]
        return module

    def exec_module(self, module: ModuleType) -> None:
        """See `importlib.abc.Loader`."""


def inside() -> int:
    """Import all modules of all packages, here; returns the number of those that fail."""
    sys.meta_path.insert(0, NoRos())
    failures = count = 0
    packages = sorted(folder.name for folder in PROJECT.glob('src/av_*') if (folder / 'setup.py').exists())
    sys.path[:0] = [str(PROJECT / 'src' / package) for package in packages]
    for package in packages:
        for found in pkgutil.walk_packages([str(PROJECT / 'src' / package / package)], f'{package}.'):
            if found.name.endswith('_parameters'):
                continue
            count += 1
            try:
                importlib.import_module(found.name)
            except Exception as error:  # noqa: BLE001  whatever it is, it is reported
                failures += 1
                if failures <= MOST_SHOWN:
                    print(f'  {found.name}: {type(error).__name__}: {error}')
    print(f'  {count - failures} of {count} modules can be imported')
    return failures


def check(name: str, folder: Path) -> bool:
    """Make a distribution's environment, and import and run everything in it; returns whether all of it works.

    Parameters:
        name: of the distribution.
        folder: for virtual environments, kept for the next time.
    """
    version, packages = UBUNTU[name]
    began, venv = time.monotonic(), folder / name
    python = find_python(version)
    if python is None:
        print(f'{name}: no Python {version} found (python{version}, or of pyenv)')
        return False
    print(f'{name}: Python {version}', flush=True)
    clean = {key: value for key, value in os.environ.items() if not key.startswith(('PYTHON', 'AMENT', 'LD_', 'ROS'))}
    if not (venv / 'done').exists():
        subprocess.run([python, '-m', 'venv', '--clear', venv], check=True)
        constraints = ['-c', str(CONSTRAINTS[name])] if name in CONSTRAINTS else []
        subprocess.run([venv / 'bin/python', '-m', 'pip', 'install', '-q', '--only-binary=:all:', *constraints,
                        *packages.split(), *BY_PIP], env=clean, check=True)
        (venv / 'done').touch()
    passed = not subprocess.run([venv / 'bin/python', __file__, '--inside'], env=clean, check=False).returncode
    print(f'  {time.monotonic() - began:.0f} s: {"works" if passed else "FAILS"}', flush=True)
    return passed


def find_python(version: str) -> str | None:
    """Path of an interpreter of a version, such as 3.10; None without."""
    pyenv = Path(os.environ.get('PYENV_ROOT', Path.home() / '.pyenv'))
    for program in (*map(str, pyenv.glob(f'versions/{version}*/bin/python')), f'python{version}', 'python3'):
        answer = shutil.which(program) and subprocess.run(
            [program, '-c', 'import sys; print("%d.%d" % sys.version_info[:2])'], capture_output=True, text=True, check=False)
        if answer and answer.stdout.strip() == version:
            return program
    return None


def main(arguments: Sequence[str] | None = None) -> int:
    """Check the distributions; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('names', nargs='*', choices=[*UBUNTU, []], help='distributions of Ubuntu; all by default')
    parser.add_argument('--folder', type=Path, default=PROJECT / 'build/distributions', help='for virtual environments')
    parser.add_argument('--inside', action='store_true', help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.inside:
        return min(inside(), 1)
    passed = [check(name, options.folder) for name in options.names or UBUNTU]
    return int(not all(passed))


if __name__ == '__main__':
    sys.exit(main())
