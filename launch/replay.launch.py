"""Replay of a bag with its own clock. The nodes after the played stage compute the remaining topics.

ros2 launch av_fusion replay.launch.py bag:=flight.mcap                       play sound and images
ros2 launch av_fusion replay.launch.py bag:=flight.mcap only:=doa rate:=4     play directions and detections
ros2 launch av_fusion replay.launch.py bag:=flight.mcap only:=bearing         play the recorded bearings
ros2 launch av_fusion replay.launch.py bag:=flight.mcap only:=all             play all topics, for the monitor only
"""

from __future__ import annotations

from collections.abc import Sequence

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import EmitEvent, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.events.process import ProcessExited

from av_bringup.launching import (
    BAG_TIME,
    RIG_ARGUMENTS,
    Arguments,
    LaunchedNode,
    describe,
    detector_nodes,
    doa_node,
    monitor_nodes,
    number,
    recorder_nodes,
    require,
    rig_node,
    view_nodes,
    whole_number,
)

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
        if (begin := number(arguments, 'start', 'seconds', 0.0)) >= bag.length:
            raise ValueError(f'start is {begin:g} s, and the bag has {bag.length:.1f} s')
    if arguments['model'] not in ('', 'shipped'):
        from av_vision.methods import check_model
        check_model(arguments['model'])
    only = arguments['only']
    timed = {**arguments, BAG_TIME: 'true'}
    pointing = rig_node(timed, 'av_pointing', 'pointing_node', {'rig_file': arguments['rig']})
    receivers, others = monitor_nodes(timed), []
    if only == 'raw' and names.AUDIO in found:
        receivers.append(doa_node(timed))
    if only == 'raw' and arguments['model']:
        receivers += detector_nodes(timed)
    if only in ('raw', 'doa'):
        receivers.append(rig_node(timed, 'av_fusion', 'fusion_node', {'rig_file': arguments['rig']}))
        others.append(pointing)
    if only == 'bearing':
        receivers.append(pointing)
    if names.FRAMES not in found or names.GIMBAL in found:  # which makes the gimbal's transforms
        others.append(rig_node(timed, 'av_pointing', 'rig_frames_node', {'rig_file': arguments['rig'], 'model': False}))
    receivers += recorder_nodes({**timed, 'bags': ''})
    player = player_node(arguments, [node.node_executable for node in receivers])
    processes = [*others, *receivers, *view_nodes(timed), player]
    return [*ends_with(player, processes), *processes]


def player_node(arguments: Arguments, receivers: list[str]) -> LaunchedNode:
    """The player, which also publishes the clock.

    Parameters:
        arguments: the launch arguments.
        receivers: names of the nodes for which the player waits before it starts.
    """
    texts = {name: arguments[name] for name in ('bag', 'bags', 'only', 'recorded_namespace', 'audio_format')}
    numbers = {name: number(arguments, name, 'a number') for name in ('rate', 'duration')}
    counts = {name: whole_number(arguments, name) for name in ('audio_rate', 'audio_channels')}
    return rig_node(arguments, 'av_bags', 'player_node', {
        **texts, **numbers, **counts, 'position': number(arguments, 'start', 'seconds'),
        'remap': arguments['remap'].split(','), 'wait_for': receivers,
        'detections': not arguments['model']}, output='screen', respawn=False)


def ends_with(last: LaunchedNode, processes: Sequence[LaunchedNode]) -> list[LaunchDescriptionEntity]:
    """Event handlers that end the launch; a process that ends before fails it, with an exit code other than 0.

    Parameters:
        last: the process whose end is the run's.
        processes: all processes of the run.
    """
    def check(event: ProcessExited, context: LaunchContext) -> None:
        if event.action in processes and not context.is_shutdown and (event.action is not last or event.returncode):
            raise RuntimeError(f'{event.process_name} ended with exit code {event.returncode} while the rig was running')
    shutdown = EmitEvent(event=Shutdown(reason='the run is over'))
    return [RegisterEventHandler(OnProcessExit(on_exit=check)),
            RegisterEventHandler(OnProcessExit(target_action=last, on_exit=[shutdown]))]
