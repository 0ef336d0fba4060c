"""Replay of a bag with its own clock. The nodes after the played stage compute the remaining topics.

ros2 launch av_fusion replay.launch.py bag:=flight.mcap                       play sound and images
ros2 launch av_fusion replay.launch.py bag:=flight.mcap only:=doa rate:=4     play directions and detections
ros2 launch av_fusion replay.launch.py bag:=flight.mcap only:=bearing         play the recorded bearings
ros2 launch av_fusion replay.launch.py bag:=flight.mcap only:=all             play all topics, for the monitor only
"""

from __future__ import annotations

from launch import LaunchDescription, LaunchDescriptionEntity

from av_bringup.launching import (
    RIG_ARGUMENTS,
    Arguments,
    LaunchedNode,
    describe,
    detector_nodes,
    doa_node,
    ends_with,
    monitor_nodes,
    recorder_nodes,
    require,
    rig_node,
    view_nodes,
)

BAG_TIME = {'use_sim_time': True}
ARGUMENTS = {
    'bag': (None, 'the recording: a file or a folder, mcap or sqlite3 (.db3)', None),
    'only': ('raw', 'the stage that is played; later stages are computed', ['raw', 'doa', 'bearing', 'all']),
    'rate': ('1.0', 'speed of the player, relative to the recording', None),
    'start': ('0.0', 'time after the start of the bag at which playing starts (s)', None),
    'duration': ('0.0', 'duration of playing (s of the bag); 0 plays to its end', None),
    'remap': ('', 'other names of topics in the bag, separated by commas: odometry:=/robot/odom,doa:=/robot/doa', None),
    'recorded_namespace': ('', 'the namespace of the recorded rig', None),
    'audio_rate': ('0', 'for audio bytes without AudioInfo: sample rate (Hz)', None),
    'audio_channels': ('2', 'for audio bytes without AudioInfo: number of channels', None),
    'audio_format': ('S16LE', 'for audio bytes without AudioInfo: sample format', ['S16LE', 'S32LE', 'F32LE']),
    'model': ('', "only:=raw: a detector's ONNX file, or `shipped`; empty: use the recorded detections", None),
    **RIG_ARGUMENTS,
}


def generate_launch_description() -> LaunchDescription:
    """The player and the nodes after the played stage. They depend on the arguments and on the bag's topics."""
    return describe(ARGUMENTS, start)


def start(arguments: Arguments) -> list[LaunchDescriptionEntity]:
    """The nodes that compute topics that are not played, and the player, which ends the launch. Raises MissingPackageError."""
    require(f'bag:={arguments["bag"]}', 'av_bags')
    from av_bags import topics as names  # only where av_bags is installed
    from av_bags.reader import Bag
    from av_bags.topics import find_topics, parse_remappings

    with Bag(arguments['bag']) as bag:
        found = find_topics(bag, names.KINDS, parse_remappings(arguments['remap'].split(',')),
                            arguments['recorded_namespace'])
    only = arguments['only']
    pointing = rig_node(arguments, 'av_pointing', 'pointing_node', {'rig_file': arguments['rig'], **BAG_TIME})
    receivers, others = monitor_nodes(arguments, BAG_TIME), []
    if only == 'raw' and names.AUDIO in found:
        receivers.append(doa_node(arguments, BAG_TIME))
    if only == 'raw' and arguments['model']:
        receivers += detector_nodes(arguments, BAG_TIME)
    if only in ('raw', 'doa'):
        receivers.append(rig_node(arguments, 'av_fusion', 'fusion_node', {'rig_file': arguments['rig'], **BAG_TIME}))
        others.append(pointing)
    if only == 'bearing':
        receivers.append(pointing)
    if names.FRAMES not in found or names.GIMBAL in found:  # which makes the gimbal's transforms
        frames = {'rig_file': arguments['rig'], 'model': False, **BAG_TIME}
        others.append(rig_node(arguments, 'av_pointing', 'rig_frames_node', frames))
    receivers += recorder_nodes({**arguments, 'bags': ''}, BAG_TIME)
    player = player_node(arguments, [node.node_executable for node in receivers])
    processes = [*others, *receivers, *view_nodes(arguments, BAG_TIME), player]
    return [*ends_with(player, processes), *processes]


def player_node(arguments: Arguments, receivers: list[str]) -> LaunchedNode:
    """The player, which also publishes the clock.

    Parameters:
        arguments: the launch arguments.
        receivers: names of the nodes for which the player waits before it starts.
    """
    texts = {name: arguments[name] for name in ('bag', 'bags', 'only', 'recorded_namespace', 'audio_format')}
    numbers = {name: float(arguments[name]) for name in ('rate', 'duration')}
    counts = {name: int(arguments[name]) for name in ('audio_rate', 'audio_channels')}
    return rig_node(arguments, 'av_bags', 'player_node', {
        **texts, **numbers, **counts, 'position': float(arguments['start']),
        'remap': arguments['remap'].split(','), 'wait_for': receivers,
        'detections': not arguments['model']}, output='screen', respawn=False)
