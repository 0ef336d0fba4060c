"""The rig: sensors or a simulator, direction of arrival, detection, fusion, pointing, and a monitor to read along.

ros2 launch av_fusion rig.launch.py                                             the built-in simulator
ros2 launch av_fusion rig.launch.py source:=udp                                 an external simulator such as RFlySim
ros2 launch av_fusion rig.launch.py source:=file audio:=X.wav video:=Y.mp4      recordings
ros2 launch av_fusion rig.launch.py source:=hardware                            microphones and camera
ros2 launch av_fusion rig.launch.py source:=hardware px4:=true                  ... on a vehicle with PX4
"""

from __future__ import annotations

import importlib.util
from dataclasses import asdict
from pathlib import Path

from ament_index_python.packages import get_package_prefix, get_package_share_directory
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch_ros.actions import Node

from av_sim_bridge.rig import load_rig
from av_sim_bridge.wire.ports import Ports

CONFIG = Path(get_package_share_directory('av_fusion')) / 'config'
ARGUMENTS = {
    'source': ('sim', 'where sound and pictures come from', ['sim', 'udp', 'file', 'hardware']),
    'scenario': ('fog_woodland', "source:=sim: a shipped scenario's name or a file", None),
    'renderer': ('', 'source:=sim: scene (3D) or painter (flat, cheap); empty: scene where a detector looks at it',
                 ['', 'scene', 'painter']),
    'image_rate': ('10', 'source:=sim: pictures a second', None),
    'voice': ('', "source:=sim: a recording as the drone's voice", None),
    'audio_header': ('true', 'source:=sim: count and date the sound datagrams; false: bare samples, as RFlySim sends',
                     ['true', 'false']),
    'seed': ('', "source:=sim: another seed than the scenario's", None),
    'audio': ('', 'source:=file: a sound file; empty: deaf', None),
    'video': ('', 'source:=file: a video or a folder of pictures; empty: blind', None),
    'model': ('', "a detector's ONNX file, or `shipped`; empty: shipped, but with simulators their visual oracle", None),
    'classes': ('', 'classes of the model to be taken for the target, separated by commas', None),
    'rig': (str(CONFIG / 'rig.yaml'), 'description of the rig: array, camera and where they sit', None),
    'array': ('', "an array file other than the rig's", None),
    'params': ('', 'a parameter file read after config/rig_params.yaml', None),
    'namespace': ('', 'a namespace, so that several rigs run side by side', None),
    'port_offset': ('0', 'source:=sim or udp: added to every UDP port, so that several rigs run side by side', None),
    'duration': ('0', 'end after this many seconds; 0 runs until Ctrl-C', None),
    'out': ('', 'a folder for the table, the picture and figures; empty writes none', None),
    'record': ('', 'record the topics to this bag (mcap)', None),
    'px4': ('false', "turn PX4's gimbal and body, take its attitude as odometry; needs px4_msgs, see docs/px4.md",
            ['true', 'false']),
    'enable_pointing': ('', 'let commands move the rig from the start; by default with simulators only, not with px4',
                        ['', 'true', 'false']),
}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; what to start depends on their values."""
    declared = [DeclareLaunchArgument(name, default_value=default, description=text, choices=choices)
                for name, (default, text, choices) in ARGUMENTS.items()]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def start(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """The processes that the arguments ask for, and the rules of how they end together."""
    arguments = {name: context.launch_configurations[name] for name in ARGUMENTS}
    try:
        duration = float(arguments['duration'])
    except ValueError as error:
        raise ValueError(f"duration is {arguments['duration']!r}, expected seconds") from error
    for name in ('audio', 'video', 'voice', 'model', 'rig', 'array', 'params'):
        if arguments[name] not in ('', 'shipped') and not Path(arguments[name]).exists():
            raise FileNotFoundError(f'{name}:={arguments[name]}: no such file')
    sources = {'sim': simulator, 'udp': bridge, 'file': files, 'hardware': hardware}
    monitor = rig_node(arguments, 'av_fusion', 'monitor_node', {
        'duration': duration, 'out': arguments['out'], 'title': title(arguments)}, output='screen', sigterm_timeout='20')
    processes = [
        rig_node(arguments, 'av_fusion', 'rig_frames_node', {'rig_file': arguments['rig']}),
        rig_node(arguments, 'av_audio', 'doa_node', {'array_file': array_file(arguments)}),
        rig_node(arguments, 'av_fusion', 'fusion_node', {}),
        rig_node(arguments, 'av_fusion', 'pointing_node', {'enabled': may_move(arguments)}),
        monitor, *sources[arguments['source']](arguments)]
    if arguments['px4'] == 'true':
        processes.append(px4(arguments))
    if arguments['record']:
        processes.append(rig_node(arguments, 'av_fusion', 'recorder_node', {'path': arguments['record']}))
    finished = RegisterEventHandler(OnProcessExit(target_action=monitor, on_exit=[
        EmitEvent(event=Shutdown(reason='the run is over'))]))
    return [RegisterEventHandler(OnProcessExit(on_exit=lambda event, context: check_exit(event, context, monitor))),
            finished, *processes]


def rig_node(arguments: dict[str, str], package: str, executable: str, parameters: dict, **options: object) -> Node:
    """A node of the rig with the shipped parameters, those of this launch, and the user's on top."""
    files = [str(CONFIG / 'rig_params.yaml'), parameters, *filter(None, [arguments['params']])]
    return Node(package=package, executable=executable, name=executable, namespace=arguments['namespace'],
                parameters=files, **{'output': 'log', **options})


def simulator(arguments: dict[str, str]) -> list[LaunchDescriptionEntity]:
    """The built-in simulator, which knows nothing of ROS, and the bridge to it."""
    program = Path(get_package_prefix('av_sim_bridge')) / 'lib' / 'av_sim_bridge' / 'simulator'
    options = ['--rig', arguments['rig'], '--port-offset', arguments['port_offset'], '--duration', 'inf']
    options += ['--renderer', arguments['renderer'] or ('scene' if arguments['model'] else 'painter')]
    options += ['--audio-header'] if arguments['audio_header'] == 'true' else []
    for name in ('image_rate', 'voice', 'seed'):
        options += [f"--{name.replace('_', '-')}", arguments[name]] if arguments[name] else []
    return [ExecuteProcess(cmd=[str(program), arguments['scenario'], *options], name='simulator', output='screen'),
            *bridge(arguments)]


def bridge(arguments: dict[str, str]) -> list[LaunchDescriptionEntity]:
    """The bridge from a simulator's UDP streams, with a detector when there is a model for it."""
    ports = asdict(Ports().shifted(int(arguments['port_offset'])))
    parameters = {'rig_file': arguments['rig'], 'oracle_detections': not arguments['model'],
                  **{f'{name}_port': port for name, port in ports.items()}}
    # With PX4 the simulated rig is where PX4 says: the bridge neither turns it nor tells where it is.
    elsewhere = [('odometry', 'truth/odometry'), ('pointing/command', 'truth/command')] if arguments['px4'] == 'true' else []
    node = rig_node(arguments, 'av_sim_bridge', 'bridge_node', parameters, remappings=elsewhere)
    return [node, *detector(arguments)] if arguments['model'] else [node]


def files(arguments: dict[str, str]) -> list[LaunchDescriptionEntity]:
    """Recordings played as if they were heard and seen now."""
    sensors = []
    if arguments['audio']:
        sensors.append(rig_node(arguments, 'av_audio', 'audio_node', {'source': 'file', 'file': arguments['audio']}))
    if arguments['video']:
        sensors += [rig_node(arguments, 'av_vision', 'camera_node', {'source': 'file', 'file': arguments['video']}),
                    *detector(arguments)]
    return sensors


def hardware(arguments: dict[str, str]) -> list[LaunchDescriptionEntity]:
    """Microphones and camera; which ones, the parameter file says."""
    return [rig_node(arguments, 'av_audio', 'audio_node', {'source': 'device'}),
            rig_node(arguments, 'av_vision', 'camera_node', {'source': 'device'}), *detector(arguments)]


def px4(arguments: dict[str, str]) -> LaunchDescriptionEntity:
    """The node between the rig and PX4, which also moves the built-in simulator's rig. Raises ImportError without px4_msgs."""
    if importlib.util.find_spec('px4_msgs') is None:
        raise ImportError('px4:=true needs px4_msgs: clone https://github.com/PX4/px4_msgs, the branch of your firmware (such '
                          'as release/1.16), into the workspace, and build and source it; see docs/px4.md')
    port = Ports().shifted(int(arguments['port_offset'])).control if arguments['source'] == 'sim' else 0
    return rig_node(arguments, 'av_px4', 'px4_node', {'simulator_port': port})


def detector(arguments: dict[str, str]) -> list[LaunchDescriptionEntity]:
    """The detector, with the model given or the shipped one."""
    model = '' if arguments['model'] == 'shipped' else arguments['model']
    classes = {'keep_classes': arguments['classes'].split(',')} if arguments['classes'] else {}
    return [rig_node(arguments, 'av_vision', 'detector_node', {'model': model, **classes})]


def array_file(arguments: dict[str, str]) -> str:
    """The microphones' positions: the file given, or the one that the rig's description names."""
    return arguments['array'] or str(load_rig(arguments['rig']).array.file)


def may_move(arguments: dict[str, str]) -> bool:
    """Simulated rigs move from the start, real ones and any with an autopilot only when told to."""
    if arguments['enable_pointing']:
        return arguments['enable_pointing'] == 'true'
    return arguments['source'] in ('sim', 'udp') and arguments['px4'] == 'false'


def title(arguments: dict[str, str]) -> str:
    """What runs, for the heading of table and picture."""
    named = {'sim': arguments['scenario'], 'udp': 'external simulator',
             'file': ' and '.join(filter(None, [arguments['audio'], arguments['video']])), 'hardware': 'hardware'}
    return named[arguments['source']]


def check_exit(event: object, context: LaunchContext, monitor: Node) -> None:
    """A process that ends before the run is over fails the launch: its exit code is then not 0."""
    if context.is_shutdown or (event.action is monitor and event.returncode == 0):
        return
    raise RuntimeError(f'{event.process_name} ended with exit code {event.returncode} while the rig was running')
