"""Check that every package.xml lists exactly the imports of its package: `package_dependencies.py [--write] src/*`.

Modules found at run time only (optional libraries, entry points of launch files) are listed in `OPTIONAL` and `IMPLICIT`.
A package's tests may not import a package that needs the tested one: such a test belongs to the other package, or to test/.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

# rosdep keys of Python modules; any other module is a ROS package of the same name.
KEYS = {
    '_pytest': 'python3-pytest', 'pytest_timeout': 'python3-pytest-timeout',
    'cv2': 'python3-opencv', 'h5py': 'python3-h5py', 'hypothesis': 'python3-hypothesis', 'jsonschema': 'python3-jsonschema',
    'matplotlib': 'python3-matplotlib', 'mcap': 'mcap-ros2-support', 'mcap_ros2': 'mcap-ros2-support',
    'mujoco': 'python3-mujoco-pip', 'numpy': 'python3-numpy', 'onnxruntime': 'python3-onnxruntime-pip',
    'psutil': 'python3-psutil', 'pyrealsense2': 'python3-pyrealsense2-pip', 'pytest': 'python3-pytest',
    'rosbags': 'python3-rosbags-pip', 'scipy': 'python3-scipy', 'sounddevice': 'python3-sounddevice-pip',
    'soundfile': 'python3-soundfile', 'transforms3d': 'python3-transforms3d', 'yaml': 'python3-yaml',
}
# Optional modules, and modules without a rosdep key, which requirements.txt lists.
OPTIONAL = {'audio_common_msgs', 'google', 'lz4', 'onnx',
            'pyroomacoustics', 'px4_msgs', 'sapient_msg', 'setuptools',
            'websockets', 'zenoh'}
# Dependencies of a package without an import.
IMPLICIT = {
    'av_audio': {'portaudio19-dev'},
    'av_bringup': {'openssl', 'rmw_cyclonedds_cpp'},
    'av_fusion': {'av_audio', 'av_bringup', 'av_pointing'},     # of the launch files
    'av_simulator': {'av_bringup'},     # which installs the configuration
}
# Plugins with which `make test` runs the tests of all packages; listed once, for the package below all others.
TEST_PLUGINS = {'av_common': {'python3-pytest-timeout', 'python3-pytest-xdist'}}
PARAMETERS = 'generate_parameter_library_py'


def imported(files: Iterable[Path]) -> set[str]:
    """Top-level modules that the files import, except the standard library."""
    found: set[str] = set()
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                found |= {name.name.split('.')[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.split('.')[0])
    return found - set(sys.stdlib_module_names) - OPTIONAL


def sources(package: Path) -> list[Path]:
    """Modules of a package, except those generated from *_parameters.yaml."""
    return [file for file in (package / package.name).rglob('*.py') if not file.name.endswith('_parameters.py')]


def tested(package: Path) -> set[str]:
    """Modules that a package's tests import, except the package itself and modules in folders of tests."""
    local = {file.stem for file in package.parent.glob('*/test/*.py')}
    return imported((package / 'test').rglob('*.py')) - {package.name} - local


def users(package: Path) -> set[str]:
    """Packages that import this one, directly or indirectly."""
    imports = {other.name: imported(sources(other)) for other in package.parent.iterdir() if (other / 'setup.py').exists()}
    found = {package.name}
    while more := {name for name, modules in imports.items() if modules & found} - found:
        found |= more
    return found - {package.name}


def wanted(package: Path) -> dict[str, list[str]]:
    """The rosdep keys that a package.xml must list, by kind of dependency."""
    run = {KEYS.get(name, name) for name in imported(sources(package)) - {package.name}} | IMPLICIT.get(package.name, set())
    build = {PARAMETERS} if list(package.glob(f'{package.name}/nodes/*_parameters.yaml')) else set()
    build |= imported([package / 'setup.py']) & {'av_common'} - {package.name}
    test = {KEYS.get(name, name) for name in tested(package) - users(package)} | TEST_PLUGINS.get(package.name, set())
    return {'depend': sorted(build), 'exec_depend': sorted(run - build), 'test_depend': sorted(test - run - build)}


def write(package: Path) -> None:
    """Replace the dependencies of a package.xml."""
    file = package / 'package.xml'
    text = file.read_text(encoding='utf-8')
    lines = ''.join(f'  <{kind}>{key}</{kind}>\n' for kind, names in wanted(package).items() for key in names)
    head, tail = text.split('</license>\n')[0] + '</license>\n', text[text.index('  <export>'):]
    file.write_text(f'{head}\n{lines}\n{tail}', encoding='utf-8')


def faults(package: Path) -> Iterator[str]:
    """Faults of a package.xml and of the imports in tests."""
    file = package / 'package.xml'
    text = file.read_text(encoding='utf-8')
    for kind, names in wanted(package).items():
        given = set(re.findall(rf'<{kind}>([\w-]+)</{kind}>', text))
        for key in sorted(given ^ set(names)):
            yield f'{file}: {kind} {key} is {"not imported" if key in given else "missing"}'
    for name in sorted(tested(package) & users(package)):
        yield f'{package / "test"}: imports {name}, which needs {package.name}: move the test to {name} or to test/'


def main(arguments: list[str]) -> int:
    """Check, or write with --write. Returns the exit code: 1 if a package.xml has faults, else 0."""
    packages = [folder for folder in map(Path, arguments) if (folder / 'setup.py').exists()]
    if '--write' in arguments:
        for package in packages:
            write(package)
        return 0
    found = [fault for package in packages for fault in faults(package)]
    print(*found, sep='\n', end='\n' if found else '')
    return int(bool(found))


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
