"""Every package.xml names just what its package imports: `package_dependencies.py [--write] src/*`.

Modules found at run time only (optional libraries, entry points of launch files) are listed in `OPTIONAL` and `IMPLICIT`.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable
from pathlib import Path

# rosdep's keys of Python modules; a module that is not here is a ROS package of the same name.
KEYS = {
    'cv2': 'python3-opencv', 'h5py': 'python3-h5py', 'hypothesis': 'python3-hypothesis', 'jsonschema': 'python3-jsonschema',
    'matplotlib': 'python3-matplotlib', 'mcap': 'mcap-ros2-support', 'mcap_ros2': 'mcap-ros2-support',
    'mujoco': 'python3-mujoco-pip', 'numpy': 'python3-numpy', 'onnxruntime': 'python3-onnxruntime-pip',
    'pyrealsense2': 'python3-pyrealsense2-pip', 'pytest': 'python3-pytest', 'rosbags': 'python3-rosbags-pip',
    'scipy': 'python3-scipy', 'sounddevice': 'python3-sounddevice-pip', 'soundfile': 'python3-soundfile',
    'transforms3d': 'python3-transforms3d', 'yaml': 'python3-yaml',
}
# Used where they are installed, or without a key: requirements.txt names them.
OPTIONAL = {'acoular', 'audio_common_msgs', 'distributed', 'lz4', 'onnx', 'pyroadacoustics', 'pyroomacoustics', 'px4_msgs',
            'zstandard', 'setuptools'}
# What a package needs without importing it.
IMPLICIT = {
    'av_audio': {'portaudio19-dev'},
    'av_fusion': {'av_audio', 'av_pointing', 'rmw_cyclonedds_cpp'},  # nodes that every launch starts
}
PARAMETERS = 'generate_parameter_library_py'


def imported(files: Iterable[Path]) -> set[str]:
    """Top-level modules that the files import, but for Python's own."""
    found: set[str] = set()
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                found |= {name.name.split('.')[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.split('.')[0])
    return found - set(sys.stdlib_module_names) - OPTIONAL


def wanted(package: Path) -> dict[str, list[str]]:
    """Keys that a package.xml should have, by kind of dependency."""
    source = [file for file in (package / package.name).rglob('*.py') if not file.name.endswith('_parameters.py')]
    tests = list((package / 'test').rglob('*.py'))
    local = {file.stem for file in tests} | {file.stem for other in package.parent.glob('*/test/*.py') for file in [other]}
    run = {KEYS.get(name, name) for name in imported(source) - {package.name}} | IMPLICIT.get(package.name, set())
    build = {PARAMETERS} if list(package.glob(f'{package.name}/nodes/*_parameters.yaml')) else set()
    test = {KEYS.get(name, name) for name in imported(tests) - {package.name} - local}
    return {'depend': sorted(build), 'exec_depend': sorted(run - build), 'test_depend': sorted(test - run - build)}


def main(arguments: list[str]) -> int:
    """Check, or write with --write; 1 when a package.xml is not as it should be."""
    failures = 0
    for folder in map(Path, arguments):
        if folder == Path('--write') or not (folder / 'setup.py').exists():
            continue
        file = folder / 'package.xml'
        text = file.read_text(encoding='utf-8')
        keys = wanted(folder)
        if '--write' in arguments:
            lines = ''.join(f'  <{kind}>{key}</{kind}>\n' for kind, names in keys.items() for key in names)
            head, tail = text.split('</license>\n')[0] + '</license>\n', text[text.index('  <export>'):]
            file.write_text(f'{head}\n{lines}\n{tail}', encoding='utf-8')
            continue
        for kind, names in keys.items():
            given = set(re.findall(rf'<{kind}>([\w-]+)</{kind}>', text))
            for key in sorted(given ^ set(names)):
                failures += 1
                print(f'{file}: {kind} {key} is {"not imported" if key in given else "missing"}')
    return int(failures > 0)


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
