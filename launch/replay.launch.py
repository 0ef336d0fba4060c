"""A recording instead of sensors: a bag is played with its own clock, and the rig computes what follows anew.

ros2 launch av_fusion replay.launch.py bag:=flight.mcap                       from sound and pictures on
ros2 launch av_fusion replay.launch.py bag:=flight.mcap only:=doa rate:=4     from directions and detections on
ros2 launch av_fusion replay.launch.py bag:=flight.mcap only:=bearing         from the recorded bearings on
ros2 launch av_fusion replay.launch.py bag:=flight.mcap only:=all             nothing computed but table and picture
"""

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch_ros.actions import Node

from av_fusion.bags import topics as names
from av_fusion.bags.reader import Bag
from av_fusion.bags.topics import STAGES, find_topics, parse_remappings
from av_sim_bridge.rig import load_rig

CONFIG = Path(get_package_share_directory('av_fusion')) / 'config'
ARGUMENTS = {
    'bag': (None, 'the recording: mcap or sqlite3 (.db3), a file or a folder', None),
    'only': ('raw', 'what of it to play; the rest is computed anew', list(STAGES)),
    'rate': ('1.0', 'how much faster than recorded', None),
    'start': ('0.0', 'begin this long after the start of the bag (s)', None),
    'duration': ('0.0', 'end after this long (s of the bag); 0 plays to its end', None),
    'remap': ('', 'topics of other names in the bag, separated by commas: odometry:=/robot/odom,doa:=/robot/doa', None),
    'recorded_namespace': ('', 'the namespace of the recorded rig', None),
    'audio_rate': ('0', 'sound in bare bytes without AudioInfo: samples a second', None),
    'audio_channels': ('2', '... its channels', None),
    'audio_format': ('S16LE', '... the type of its samples', ['S16LE', 'S32LE', 'F32LE']),
    'model': ('', "only:=raw: a detector's ONNX file; empty takes the recorded detections", None),
    'classes': ('', 'classes of the model to be taken for the target, separated by commas', None),
    'rig': (str(CONFIG / 'rig.yaml'), 'description of the rig: array, and sensor frames if the bag has none', None),
    'array': ('', "an array file other than the rig's", None),
    'params': ('', 'a parameter file read after config/rig_params.yaml', None),
    'namespace': ('', 'a namespace for what is played and computed', None),
    'out': ('', 'a folder for the table, the picture and figures; empty writes none', None),
    'record': ('', 'record what is played and computed to this bag (mcap)', None),
}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; what to start depends on their values and on the bag."""
    declared = [DeclareLaunchArgument(name, default_value=default, description=text, choices=choices)
                for name, (default, text, choices) in ARGUMENTS.items()]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def start(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """The nodes that compute what the bag is not to tell, then the player, whose end ends everything."""
    arguments = {name: context.launch_configurations[name] for name in ARGUMENTS}
    with Bag(arguments['bag']) as bag:
        found = find_topics(bag, names.KINDS, parse_remappings(arguments['remap'].split(',')),
                            arguments['recorded_namespace'])
    only = arguments['only']
    listening = [monitor(arguments)]
    if only == 'raw' and names.AUDIO in found:
        array = arguments['array'] or str(load_rig(arguments['rig']).array.file)
        listening.append(rig_node(arguments, 'av_audio', 'doa_node', {'array_file': array}))
    if only == 'raw' and arguments['model']:
        classes = {'keep_classes': arguments['classes'].split(',')} if arguments['classes'] else {}
        listening.append(rig_node(arguments, 'av_vision', 'detector_node', {'model': arguments['model'], **classes}))
    if only in ('raw', 'doa'):
        listening.append(rig_node(arguments, 'av_fusion', 'fusion_node', {}))
    if only == 'bearing':
        listening.append(rig_node(arguments, 'av_fusion', 'pointing_node', {}))
    beside = []
    if only in ('raw', 'doa'):
        beside.append(rig_node(arguments, 'av_fusion', 'pointing_node', {}))
    if names.FRAMES not in found:
        beside.append(rig_node(arguments, 'av_fusion', 'rig_frames_node', {'rig_file': arguments['rig']}))
    if arguments['record']:
        listening.append(rig_node(arguments, 'av_fusion', 'recorder_node', {'path': arguments['record']}))
    player = play(arguments, [node.node_executable for node in listening])
    ended = RegisterEventHandler(OnProcessExit(target_action=player, on_exit=[
        EmitEvent(event=Shutdown(reason='the bag has ended'))]))
    return [RegisterEventHandler(OnProcessExit(on_exit=lambda event, context: check_exit(event, context, player))),
            ended, *beside, *listening, player]


def rig_node(arguments: dict[str, str], package: str, executable: str, parameters: dict, **options: object) -> Node:
    """A node of the rig in the bag's time, with the shipped parameters, those of this launch, and the user's on top."""
    files = [str(CONFIG / 'rig_params.yaml'), {'use_sim_time': True, **parameters},
             *filter(None, [arguments['params']])]
    return Node(package=package, executable=executable, name=executable, namespace=arguments['namespace'],
                parameters=files, **{'output': 'log', **options})


def monitor(arguments: dict[str, str]) -> Node:
    """The status line, and at the end table and picture."""
    return rig_node(arguments, 'av_fusion', 'monitor_node', {
        'out': arguments['out'], 'title': f'{arguments["bag"]}, played from {arguments["only"]}'},
        output='screen', sigterm_timeout='20')


def play(arguments: dict[str, str], listeners: list[str]) -> Node:
    """The player, which makes the clock and so has none to follow."""
    texts = {name: arguments[name] for name in ('bag', 'only', 'recorded_namespace', 'audio_format')}
    numbers = {name: float(arguments[name]) for name in ('rate', 'start', 'duration')}
    counts = {name: int(arguments[name]) for name in ('audio_rate', 'audio_channels')}
    return Node(package='av_fusion', executable='player_node', name='player_node', namespace=arguments['namespace'],
                output='screen', parameters=[{
                    **texts, **numbers, **counts, 'remap': arguments['remap'].split(','), 'wait_for': listeners,
                    'detections': not arguments['model']}])


def check_exit(event: object, context: LaunchContext, player: Node) -> None:
    """A process that ends before the bag does fails the launch: its exit code is then not 0."""
    if context.is_shutdown or (event.action is player and event.returncode == 0):
        return
    raise RuntimeError(f'{event.process_name} ended with exit code {event.returncode} while the bag was playing')
