"""Describe your rig: `ros2 run av_view setup` asks, and writes its array, its description and its parameters.

The answer in brackets is taken by Enter. Positions are in metres from the middle of the body: x forward, y left, z up.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml

from av_bringup.launching import CONFIG
from av_common.arguments import checked, within
from av_common.microphone_array import MicrophoneArray
from av_view.doctor.files import judge_files
from av_view.doctor.program import devices

T = TypeVar('T')
ARRAYS = sorted(file.stem for file in (CONFIG / 'arrays').glob('*.yaml'))
DEFAULT_MOUNT, DEFAULT_CAMERA = '0 0 0.1', '0.08 0 0.05'


def ask(question: str, default: str, parse: Callable[[str], T]) -> T:
    """The answer to a question, which is asked again until it can be used. Raises EOFError where no answer comes.

    Parameters:
        question: to print.
        default: the answer for an empty line.
        parse: makes the answer's value of its text; raises ValueError or ArgumentTypeError.
    """
    while True:
        try:
            return parse(input(f'{question} [{default}]: ').strip() or default)
        except (ValueError, argparse.ArgumentTypeError) as error:
            print(f'  {error}')


def position(text: str) -> list[float]:
    """Three numbers in m, by spaces or commas. Raises ValueError for others."""
    values = [float(word) for word in text.replace(',', ' ').split()]
    if len(values) != 3 or not all(abs(value) <= 100.0 for value in values):
        raise ValueError(f'{text!r}, expected x y z in metres, such as {DEFAULT_MOUNT}')
    return values


def whole_numbers(count: int) -> Callable[[str], list[int]]:
    """A parser of `count` channels, by spaces or commas."""
    def parse(text: str) -> list[int]:
        values = [int(word) for word in text.replace(',', ' ').split()]
        if len(values) != count or len(set(values)) != count or min(values) < 0:
            raise ValueError(f'{text!r}, expected {count} different channels from 0')
        return values
    return parse


def array_of(text: str) -> MicrophoneArray:
    """A shipped array by its name, or a pair with a spacing in m. Raises ArgumentTypeError for others."""
    if text in ARRAYS:
        return MicrophoneArray.load(CONFIG / 'arrays' / f'{text}.yaml')
    half = 0.5 * checked(text, lambda spacing: 0.01 <= spacing <= 2.0,
                         f'{", ".join(ARRAYS)}, or the spacing of a pair of 0.01 to 2 m')
    return MicrophoneArray(np.array([[0.0, half, 0.0], [0.0, -half, 0.0]]), 'my_pair')


def yes(text: str) -> bool:
    """Whether the answer is yes. Raises ValueError for neither."""
    if text.lower() not in ('y', 'yes', 'n', 'no'):
        raise ValueError(f'{text!r}, expected y or n')
    return text.lower().startswith('y')


def interview() -> tuple[MicrophoneArray, dict[str, Any], dict[str, Any]]:
    """The array, the rig's description, and the parameters, by the answers of a person."""
    for finding in devices():
        print(finding.lines())
    array = ask(f'Microphones: {", ".join(ARRAYS)}, or the spacing of a pair (m)', '0.2', array_of)
    sound = {'source': 'device', 'device': ask('Microphones: index or part of the name of their one device', '', str),
             'sample_rate': ask('Microphones: sample rate (Hz)', '48000', within(8000, 384_000, whole=True)),
             'channels': ask('Microphones: channels in the order of the array (of a pair: left, right)',
                             ' '.join(map(str, range(array.channels))), whole_numbers(array.channels))}
    mount = {'position': ask('Microphones: position of their middle (m)', DEFAULT_MOUNT, position),
             'rpy_deg': [0.0, 0.0, ask('Microphones: heading, counter-clockwise (deg)', '0', within(-180, 180))]}
    camera = {'width': ask('Camera: width (pixels)', '640', within(16, 8192, whole=True)),
              'height': ask('Camera: height (pixels)', '480', within(16, 8192, whole=True)),
              'horizontal_fov_deg': ask('Camera: horizontal field of view (deg)', '70', within(1, 150))}
    sight = {'source': 'device', 'device': ask('Camera: index, path, or realsense', '0', str)}
    gimbal = ask('Does a gimbal carry the camera? (y/n)', 'n', yes)
    pitch = 0.0 if gimbal else ask('Camera: looks up by (deg)', '8', within(-90, 90))
    place = ask('Gimbal: position (m)' if gimbal else 'Camera: position (m)', DEFAULT_CAMERA, position)
    rig: dict[str, Any] = {
        'array': {'file': 'array.yaml', 'mount': mount},
        'camera': {'mount': {'position': [0.0, 0.0, 0.0] if gimbal else place, 'rpy_deg': [0.0, -pitch, 0.0]}, **camera}}
    if gimbal:
        rig['gimbal'] = {'mount': {'position': place, 'rpy_deg': [0.0, 0.0, 0.0]}}
    return array, rig, {'/**/audio_node': {'ros__parameters': sound}, '/**/camera_node': {'ros__parameters': sight}}


def main(words: Sequence[str] | None = None) -> None:
    """Entry point. Exits with 1 where the files do not agree, with 2 where nothing was written."""
    parser = argparse.ArgumentParser(prog='setup', description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('folder', type=Path, nargs='?', default=Path('my_rig'), help='to write to (default: my_rig)')
    folder = parser.parse_args(words).folder
    existing = [file.name for file in (folder / name for name in ('array.yaml', 'rig.yaml', 'params.yaml')) if file.exists()]
    if existing:
        parser.error(f'{folder} has {", ".join(existing)} already: name another folder')
    try:
        array, rig, parameters = interview()
        folder.mkdir(parents=True, exist_ok=True)
    except (EOFError, KeyboardInterrupt, OSError) as error:
        print(f'\nnothing was written {error}')
        sys.exit(2)
    array.save(folder / 'array.yaml', 'By `ros2 run av_view setup`; positions in metres, in the order of the channels.')
    for name, content in (('rig.yaml', rig), ('params.yaml', parameters)):
        text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
        (folder / name).write_text(f'# By `ros2 run av_view setup`.\n{text}', encoding='utf-8')
    found, _ = judge_files(folder / 'rig.yaml', [folder / 'params.yaml'])
    print(*(finding.lines() for finding in found), sep='\n')
    rig_file, parameter_file = folder / 'rig.yaml', folder / 'params.yaml'
    print(f'\nnow:   ros2 run av_view doctor --rig {rig_file} --params {parameter_file} --clap left\n'
          f'then:  ros2 launch av_fusion rig.launch.py source:=hardware rig:={rig_file} params:={parameter_file} view:=true\n'
          f'and, beside it:  ros2 run av_view doctor --rig {rig_file} --live')
    sys.exit(int(any(finding.level == 'error' for finding in found)))
