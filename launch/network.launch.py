"""Several rigs in one simulated world, and the node that finds positions by all of them.

ros2 launch av_fusion network.launch.py                                          three rigs, the oracle as their detector
ros2 launch av_fusion network.launch.py rigs:=2 radius:=30 scenario:=circle
ros2 launch av_fusion network.launch.py view:=true                               a map of rigs and targets in a browser
ros2 topic echo /tracks
"""

from __future__ import annotations

import math
import time
from pathlib import Path

from launch import LaunchDescription, LaunchDescriptionEntity
from launch.launch_description_sources import load_python_launch_file_as_module

from av_bringup.launching import (
    RIG_ARGUMENTS,
    Arguments,
    describe,
    number,
    require,
    rig_node,
    view_nodes,
    whole_number,
)
from av_bringup.supervision import Supervision
from av_common.launched import RUN_FOLDER

MOST_RIGS = 8  # whose ports meet neither each other nor those of the system
PORTS = 250  # between those of two rigs
BEGIN_S = 3.0  # for each rig, and once more, from the launch to the beginning of the scenario, in which all processes start
ARGUMENTS = {
    'rigs': ('3', f'number of rigs, 1 to {MOST_RIGS}; their namespaces are rig1, rig2 ...', None),
    'radius': ('20', 'rigs stand on a circle around the origin, facing it: its radius (m)', None),
    'scenario': ('circle', "a shipped scenario's name or a file", None),
    'seed': ('7', 'seed of the scenario, the same for all rigs', None),
    'oracle': ('true', "the simulator's oracle gives the detections; false: the detector, which needs a core for each rig",
               ['true', 'false']),
    'cue': ('false', 'rigs are told where a target is that they do not report, their gimbals turn there', ['true', 'false']),
    'duration': ('0', 'end after this time (s); 0: run until Ctrl-C', None),
    'params': ('', 'a parameter file that overrides config/rig_params.yaml', None),
    'namespace': ('', 'namespace of the network node', None),
    **{name: RIG_ARGUMENTS[name] for name in ('view', 'view_control', 'bags')},
    'security': ('', 'a keystore of `ros2 run av_bringup security`: only nodes with its keys take part; empty: all', None),
}


def generate_launch_description() -> LaunchDescription:
    """The processes of all rigs and the network node. They depend on the values of the arguments."""
    return describe(ARGUMENTS, start)


def start(arguments: Arguments) -> list[LaunchDescriptionEntity]:
    """The processes selected by the arguments. Raises ValueError or MissingPackageError."""
    require('network.launch.py', 'av_network', 'av_simulator', 'av_sim_bridge')
    count = whole_number(arguments, 'rigs', 1, MOST_RIGS)
    radius = number(arguments, 'radius', 'metres from 1 to 1000', 1.0, 1000.0)
    duration = number(arguments, 'duration', 'seconds', 0.0)
    names = [f'rig{index + 1}' for index in range(count)]
    begin = time.time() + BEGIN_S * (1 + count)  # who is not ready by then joins
    root = '/' if arguments['namespace'] else ''    # in which the rigs are, not below the node
    node = rig_node(arguments, 'av_network', 'network_node', {
        'rigs': [root + name for name in names], 'pose_sources': ['odometry'], 'positions': [0.0] * 3 * len(names),
        'cue': arguments['cue'] == 'true'})
    supervision = Supervision([node], duration=duration)
    rigs = [entity for index in range(len(names)) for entity in _rig(arguments, names, index, radius, begin)]
    return [*supervision.entities(), *rigs, node, *view_nodes(arguments)]


def _rig(arguments: Arguments, names: list[str], index: int, radius: float, begin: float) -> list[LaunchDescriptionEntity]:
    """One rig, with a world of its own that equals that of the others."""
    angle = math.tau * index / len(names)
    place = (radius * math.cos(angle), radius * math.sin(angle), 1.5, math.degrees(angle) - 180.0)
    values = {'namespace': names[index], 'port_offset': str(PORTS * index), 'begin': f'{begin:.3f}', 'monitor': 'false',
              'at': ' '.join(f'{value:.3f}' for value in place), 'duration': '0', 'view': 'false', 'bags': '',
              **{name: arguments[name] for name in ('scenario', 'seed', 'oracle', 'params', 'security', 'cue')}}
    rig = load_python_launch_file_as_module(str(Path(__file__).with_name('rig.launch.py')))
    defaults = {name: default for name, (default, _, _) in rig.ARGUMENTS.items()}
    started: list[LaunchDescriptionEntity] = rig.start({**defaults, **values, RUN_FOLDER: arguments[RUN_FOLDER]})
    return started
