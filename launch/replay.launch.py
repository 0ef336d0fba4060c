"""A bag instead of sensors: it is played with its own clock, and the nodes behind the played stage compute the rest.

ros2 launch av_fusion replay.launch.py bag:=flight.mcap                       from sound and images on
ros2 launch av_fusion replay.launch.py bag:=flight.mcap only:=doa rate:=4     from directions and detections on
ros2 launch av_fusion replay.launch.py bag:=flight.mcap only:=bearing         from the recorded bearings on
ros2 launch av_fusion replay.launch.py bag:=flight.mcap only:=all             the monitor's table and plot alone
"""

from __future__ import annotations

from launch import LaunchDescription, LaunchDescriptionEntity
from launch_ros.actions import Node

from av_fusion.launching import (
    RIG_ARGUMENTS,
    Arguments,
    describe,
    detector_node,
    doa_node,
    ends_with,
    monitor_nodes,
    recorder_nodes,
    require,
    rig_node,
)

BAG_TIME = {'use_sim_time': True}
ARGUMENTS = {
    'bag': (None, 'the recording: mcap or sqlite3 (.db3), a file or a folder', None),
    'only': ('raw', 'the stage that is played; what follows from it is computed', ['raw', 'doa', 'bearing', 'all']),
    'rate': ('1.0', 'speed of the player, relative to the recording', None),
    'start': ('0.0', 'begin this long after the start of the bag (s)', None),
    'duration': ('0.0', 'end after this long (s of the bag); 0 plays to its end', None),
    'remap': ('', 'topics of other names in the bag, separated by commas: odometry:=/robot/odom,doa:=/robot/doa', None),
    'recorded_namespace': ('', 'the namespace of the recorded rig', None),
    'audio_rate': ('0', 'sound in bare bytes without AudioInfo: samples a second', None),
    'audio_channels': ('2', '... its number of channels', None),
    'audio_format': ('S16LE', '... its sample format', ['S16LE', 'S32LE', 'F32LE']),
    'model': ('', "only:=raw: a detector's ONNX file, or `shipped`; empty takes the recorded detections", None),
    **RIG_ARGUMENTS,
}


def generate_launch_description() -> LaunchDescription:
    """The player and the nodes behind the played stage, which depend on the arguments and on the bag's topics."""
    return describe(ARGUMENTS, start)


def start(arguments: Arguments) -> list[LaunchDescriptionEntity]:
    """The nodes that compute what is not played, and the player, whose end is the run's. Raises MissingPackageError."""
    require(f'bag:={arguments["bag"]}', 'av_bags')
    from av_bags import topics as names  # only where av_bags is installed
    from av_bags.reader import Bag
    from av_bags.topics import find_topics, parse_remappings

    with Bag(arguments['bag']) as bag:
        found = find_topics(bag, names.KINDS, parse_remappings(arguments['remap'].split(',')),
                            arguments['recorded_namespace'])
    only = arguments['only']
    pointing = rig_node(arguments, 'av_pointing', 'pointing_node', BAG_TIME)
    title = f'{arguments["bag"]}, played from {only}'
    listening, beside = monitor_nodes(arguments, {'title': title, **BAG_TIME}), []
    if only == 'raw' and names.AUDIO in found:
        listening.append(doa_node(arguments, BAG_TIME))
    if only == 'raw' and arguments['model']:
        listening.append(detector_node(arguments, BAG_TIME))
    if only in ('raw', 'doa'):
        listening.append(rig_node(arguments, 'av_fusion', 'fusion_node', BAG_TIME))
        beside.append(pointing)
    if only == 'bearing':
        listening.append(pointing)
    if names.FRAMES not in found:
        beside.append(rig_node(arguments, 'av_fusion', 'rig_frames_node', {'rig_file': arguments['rig'], **BAG_TIME}))
    listening += recorder_nodes(arguments, BAG_TIME)
    player = player_node(arguments, [node.node_executable for node in listening])
    return [*ends_with(player), *beside, *listening, player]


def player_node(arguments: Arguments, listeners: list[str]) -> Node:
    """The player, which publishes the clock; it starts when the listeners are there."""
    texts = {name: arguments[name] for name in ('bag', 'only', 'recorded_namespace', 'audio_format')}
    numbers = {name: float(arguments[name]) for name in ('rate', 'start', 'duration')}
    counts = {name: int(arguments[name]) for name in ('audio_rate', 'audio_channels')}
    return Node(package='av_bags', executable='player_node', name='player_node', namespace=arguments['namespace'],
                output='screen', parameters=[{
                    **texts, **numbers, **counts, 'remap': arguments['remap'].split(','), 'wait_for': listeners,
                    'detections': not arguments['model']}])
