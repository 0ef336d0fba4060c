"""The rig: sensors or a simulator, directions of arrival, detection, fusion, pointing, and a monitor.

ros2 launch av_fusion rig.launch.py                                             the built-in simulator
ros2 launch av_fusion rig.launch.py oracle:=true                                ... whose oracle stands in for the detector
ros2 launch av_fusion rig.launch.py source:=udp                                 an external simulator such as RFlySim
ros2 launch av_fusion rig.launch.py source:=file audio:=X.wav video:=Y.mp4      recordings
ros2 launch av_fusion rig.launch.py source:=hardware                            microphones and camera
ros2 launch av_fusion rig.launch.py source:=hardware px4:=true                  ... on a vehicle with PX4
ros2 launch av_fusion rig.launch.py view:=true                                  in a browser, too: prints an address
ros2 launch av_fusion rig.launch.py cot:=udp://239.2.3.1:6969                    ... and on the maps of TAK
ros2 launch av_fusion rig.launch.py security:=KEYSTORE                          encrypted, among nodes with keys only
"""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path

from ament_index_python.packages import get_package_prefix
from launch import LaunchDescription, LaunchDescriptionEntity
from launch.actions import ExecuteProcess, LogInfo

from av_bringup.launching import (
    CONFIG,
    RIG_ARGUMENTS,
    Arguments,
    LaunchedNode,
    MissingPackageError,
    array_file,
    audio_node,
    camera_nodes,
    describe,
    detector_nodes,
    doa_node,
    make_folder,
    monitor_nodes,
    number,
    recorder_nodes,
    require,
    rig_node,
    view_nodes,
    whole_number,
)
from av_bringup.supervision import RESPAWN, Supervision
from av_common.launched import RUN_FOLDER
from av_common.microphone_array import MicrophoneArray
from av_common.parameter_files import parameters_for
from av_common.parameters import node_parameters
from av_common.playback import Player, plan_playback

PX4_MSGS = ('clone https://github.com/PX4/px4_msgs, the branch of your firmware (such as release/1.16), into the workspace, '
            'and build and source it; see docs/guides/px4.md')
HOW_TO_ENABLE = ('commands move nothing yet; enable them from the start by enable_pointing:=true, or now by: ros2 service call '
                 "{namespace}/pointing_node/enable std_srvs/srv/SetBool '{{data: true}}'")
# Where targets are reported to: launch argument, parameter of report_node, what it is, the Python package that it needs.
REPORTS = (('sapient', 'sapient.peer', 'fusion node of SAPIENT, host:port', 'sapient_msg'),
           ('cot', 'cot.url', 'Cursor on Target, udp://239.2.3.1:6969, udp, tcp or tls and a host:port', ''),
           ('track_log', 'log.folder', 'folder for tables and GeoJSON', ''))
REPORT_ARGUMENTS = {
    name: ('', f'report targets: {text}; empty: none. Needs av_reports: docs/guides/reports.md', None)
    for name, _, text, _ in REPORTS}
ARGUMENTS = {
    'source': ('sim', 'origin of sound and images: sim needs av_simulator and av_sim_bridge, udp av_sim_bridge',
               ['sim', 'udp', 'file', 'hardware']),
    'scenario': ('fog_woodland', "source:=sim: a shipped scenario's name or a file", None),
    'renderer': ('', 'source:=sim: scene (3D) or flat (cheaper); empty: scene, or flat with oracle:=true',
                 ['', 'scene', 'flat']),
    'image_rate': ('15', 'source:=sim: images a second', None),
    'drone_recording': ('', 'source:=sim: a sound file that the drone emits', None),
    'audio_header': ('true', 'source:=sim: send audio datagrams with number and time; false: samples only, as RFlySim',
                     ['true', 'false']),
    'seed': ('', "source:=sim: seed; empty: the scenario's", None),
    'begin': ('', "source:=sim: Unix time of the scenario's beginning, so that several rigs share one world; empty: now", None),
    'at': ('', "source:=sim: the rig's place instead of the scenario's: x y z (m, ENU) and yaw (deg)", None),
    'audio': ('', 'source:=file: a sound file; empty: no sound', None),
    'video': ('', 'source:=file: a video or a folder of images; empty: no images', None),
    'video_offset': ('0', 'source:=file: when the video begins (s), after the sound; negative: before it', None),
    'model': ('shipped', "a detector's ONNX file, `shipped`, or the name of a detector of another package", None),
    'oracle': ('false', "source:=sim or udp: the simulator's visual oracle gives the detections, and no detector runs",
               ['true', 'false']),
    **RIG_ARGUMENTS,
    **REPORT_ARGUMENTS,
    'rig': ('', "description of the rig: array, camera, gimbal, and their poses; empty: the scenario's, else config/rig.yaml",
            None),
    'port_offset': ('0', 'source:=sim or udp: offset of every UDP port, for several rigs; multiples of 250 up to 1750 avoid '
                    "the ports of DDS and Linux's ephemeral ports", None),
    'bind_address': ('127.0.0.1', 'source:=udp: address of this machine at which a simulator on another one is received, with '
                     'allowed_senders; 0.0.0.0: all', None),
    'allowed_senders': ('', 'source:=udp: addresses or networks, separated by commas, from which is received; empty: this '
                        'machine', None),
    'control_host': ('127.0.0.1', 'source:=udp: host of the simulator to which commands are sent', None),
    'cue': ('false', 'follow target/cue, where other rigs have a target: its gimbal turns there, and front is told from back',
            ['true', 'false']),
    'duration': ('0', 'end after this time (s); 0: run until Ctrl-C', None),
    'px4': ('false', "move PX4's gimbal and body, use its pose as odometry; needs av_px4, px4_msgs: docs/guides/px4.md",
            ['true', 'false']),
    'enable_pointing': ('', 'enable motion commands from the start; empty: only with source:=sim and without px4',
                        ['', 'true', 'false']),
}


def generate_launch_description() -> LaunchDescription:
    """The rig's processes. They depend on the values of the arguments."""
    return describe(ARGUMENTS, start)


def start(arguments: Arguments) -> list[LaunchDescriptionEntity]:
    """The processes selected by the arguments. Raises ValueError, FileNotFoundError or MissingPackageError."""
    duration = number(arguments, 'duration', 'seconds', 0.0)
    for name in ('audio', 'video', 'drone_recording', 'rig', 'array', 'params'):
        if arguments[name] and not Path(arguments[name]).exists():
            raise FileNotFoundError(f'{name}:={arguments[name]}: no such file')
    check_source(arguments)
    if arguments['model'] not in ('', 'shipped'):
        from av_vision.methods import check_model
        check_model(arguments['model'])
    described = described_rig(arguments)
    arguments = {**arguments, 'rig': arguments['rig'] or described}
    sources = {'sim': simulator, 'udp': bridge, 'file': files, 'hardware': hardware}
    monitor = monitor_nodes(arguments, duration)
    page, optional = view_nodes(arguments), [*recorder_nodes(arguments), *report_nodes(arguments)]
    cue = arguments['cue'] == 'true'
    essential = [
        rig_node(arguments, 'av_pointing', 'rig_frames_node', {'rig_file': arguments['rig']}),
        doa_node(arguments),
        rig_node(arguments, 'av_fusion', 'fusion_node', {'rig_file': arguments['rig'], 'use_cues': cue}),
        rig_node(arguments, 'av_pointing', 'pointing_node',
                 {'enabled': may_move(arguments), 'rig_file': arguments['rig'], 'follow_cues': cue}),
        *sources[arguments['source']](arguments)]
    if arguments['px4'] == 'true':
        essential.append(px4(arguments))
    notes = []
    if not may_move(arguments):
        notes.append(LogInfo(msg=HOW_TO_ENABLE.format(namespace=f"/{arguments['namespace'].strip('/')}".rstrip('/'))))
    supervision = Supervision(essential, [*page, *optional], monitor[0] if monitor else None, duration, bool(arguments['out']))
    return [*supervision.entities(), *page, *essential, *monitor, *optional, *notes]    # people wait for the page


def check_source(arguments: Arguments) -> None:
    """Raise ValueError for an argument of another source than the one given: its description begins with its own."""
    for name, (default, text, _) in ARGUMENTS.items():
        sources = text.partition(': ')[0]
        if sources.startswith('source:=') and arguments[name] != default and \
                arguments['source'] not in sources.removeprefix('source:=').split(' or '):
            raise ValueError(f"{name}:={arguments[name]} needs {sources}, and source is {arguments['source']}")


def described_rig(arguments: Arguments) -> str:
    """The rig's description that a scenario names, else config/rig.yaml. Raises ConfigError for a scenario that is none."""
    if arguments['source'] != 'sim':
        return str(CONFIG / 'rig.yaml')
    require('source:=sim', 'av_simulator')
    from av_simulator.config_files import find_config  # only where the simulator is installed
    scenario = find_config(arguments['scenario'], 'scenarios')  # refused in a second, without what loads one
    from av_simulator.scenario import load_scenario
    return str(find_config(load_scenario(scenario).rig.description))


def simulator(arguments: Arguments) -> list[ExecuteProcess]:
    """The built-in simulator, a program without ROS, and the bridge to it."""
    require('source:=sim', 'av_simulator', 'av_sim_bridge')
    for name, expected in {'image_rate': 'images a second', 'seed': 'a number', 'begin': 'a Unix time in seconds'}.items():
        if arguments[name]:
            number(arguments, name, f'{expected}, 0 or more', 0.0)
    program = Path(get_package_prefix('av_simulator')) / 'lib' / 'av_simulator' / 'simulator'
    options = ['--rig', arguments['rig'], '--port-offset', arguments['port_offset'], '--duration', 'inf']
    options += ['--renderer', arguments['renderer'] or ('flat' if arguments['oracle'] == 'true' else 'scene')]
    options += ['--audio-header'] if arguments['audio_header'] == 'true' else []
    if arguments['at']:
        options += ['--at', *place(arguments['at'])]
    for name in ('image_rate', 'drone_recording', 'seed', 'begin'):
        options += [f"--{name.replace('_', '-')}", arguments[name]] if arguments[name] else []
    return [ExecuteProcess(cmd=[str(program), arguments['scenario'], *options], name='simulator', output='screen', **RESPAWN),
            *bridge(arguments)]


def place(given: str) -> list[str]:
    """The four numbers of `at`. Raises ValueError for anything else."""
    numbers = given.split()
    try:
        fits = len(numbers) == 4 and all(math.isfinite(float(one)) for one in numbers)
    except ValueError:
        fits = False
    if not fits:
        raise ValueError(f"at is '{given}', expected x y z (m, ENU) and yaw (deg)")
    return numbers


def bridge(arguments: Arguments) -> list[ExecuteProcess]:
    """The bridge from a simulator's UDP streams, and the detector unless the oracle stands in for it. Raises ValueError."""
    require(f'source:={arguments["source"]}', 'av_sim_bridge')
    from av_sim_bridge.receiving.allowed_senders import AllowedSenders  # only where the bridge is installed
    from av_sim_bridge.wire.ports import Ports
    oracle, ports = arguments['oracle'] == 'true', vars(Ports()).values()
    parameters = {'rig_file': arguments['rig'], 'oracle_detections': oracle,
                  'follow_odometry': arguments['px4'] == 'true',  # PX4's pose moves the simulated rig
                  'port_offset': whole_number(arguments, 'port_offset', 1 - min(ports), 65_535 - max(ports))}
    if arguments['source'] == 'udp':    # the built-in simulator is on this machine
        parameters |= {'bind_address': arguments['bind_address'], 'control_host': arguments['control_host']}
        if arguments['allowed_senders']:
            parameters['allowed_senders'] = arguments['allowed_senders'].split(',')
    node = rig_node(arguments, 'av_sim_bridge', 'bridge_node', parameters)
    given = parameters | (parameters_for(arguments['params'], node.full_name) if arguments['params'] else {})
    settings = node_parameters('av_sim_bridge', 'bridge_node', overrides=given)
    AllowedSenders(settings.allowed_senders).check_bind_address(settings.bind_address)    # the node would try again and again
    return [node] if oracle else [node, *detector_nodes(arguments)]


def files(arguments: Arguments) -> list[ExecuteProcess]:
    """The nodes that play recordings at their own speed instead of microphones and camera, on one clock.

    Raises ValueError, OSError or SourceError for recordings that cannot be played.
    """
    offset = number(arguments, 'video_offset', 'seconds')
    if offset and not (arguments['audio'] and arguments['video']):
        raise ValueError(f'video_offset is {offset}, expected seconds between sound and video: it needs audio:= and video:=')
    sensors: list[LaunchedNode] = []
    players = []
    if arguments['audio']:
        sensors.append(audio_node(arguments, {'source': 'file', 'file': arguments['audio']}))
        check_sound(arguments, sensors[0].full_name)
        players.append(Player('audio_node', max(-offset, 0.0), ['doa_node']))
    if arguments['video']:
        from av_vision.sources.files import Recording
        Recording(arguments['video'])  # refused here, before anything starts
        # The recording is the first camera's.
        sensors += [camera_nodes(arguments, {'source': 'file', 'file': arguments['video']})[0],
                    detector_nodes(arguments)[0]]
        players.append(Player('camera_node', max(offset, 0.0), ['detector_node']))
    plan_playback(Path(arguments[RUN_FOLDER]), players)
    return sensors


def check_sound(arguments: Arguments, node: str) -> None:
    """Raise OSError or ValueError in one line for a sound file that the rig cannot hear with.

    Parameters:
        arguments: values of the launch arguments
        node: full name of the one that plays it, which may select channels
    """
    from av_audio.file_source import open_sound, pick_channels  # only where recordings are played
    array = MicrophoneArray.load(array_file(arguments))
    given = parameters_for(arguments['params'], node) if arguments['params'] else {}
    with open_sound(arguments['audio']) as sound:
        count = len(pick_channels(sound.channels, [one for one in given.get('channels', []) if one >= 0], arguments['audio']))
    if count != array.channels:
        raise ValueError(f"{arguments['audio']} gives {count} channel(s), but the array {array.name} has {array.channels} "
                         'microphones; choose with channels of audio_node, or another array:=')


def hardware(arguments: Arguments) -> list[ExecuteProcess]:
    """The nodes of microphones and cameras, which are selected in the parameter file."""
    return [audio_node(arguments, {'source': 'device'}),
            *camera_nodes(arguments, {'source': 'device'}), *detector_nodes(arguments)]


def report_nodes(arguments: Arguments) -> list[ExecuteProcess]:
    """The node that reports targets, or an empty list where nobody is named.

    Raises MissingPackageError, or ValueError for an address that is none.
    """
    peers = {}
    for name, parameter, _, module in REPORTS:
        if arguments[name]:
            require(f'{name}:={arguments[name]}', 'av_reports')
            if module and importlib.util.find_spec(module) is None:
                package = module.replace('_', '-')
                raise MissingPackageError(package, f'{name}:={arguments[name]}', f'pip install {package}')
            peers[parameter] = arguments[name]
    if peers:
        node_parameters('av_reports', 'report_node', overrides=peers)
    if arguments['track_log']:
        make_folder('track_log', arguments['track_log'])
    return [rig_node(arguments, 'av_reports', 'report_node', peers)] if peers else []


def px4(arguments: Arguments) -> ExecuteProcess:
    """The node between the rig and PX4. Raises MissingPackageError without av_px4 or px4_msgs."""
    require('px4:=true', 'av_px4')
    if importlib.util.find_spec('px4_msgs') is None:
        raise MissingPackageError('px4_msgs', 'px4:=true', PX4_MSGS)
    return rig_node(arguments, 'av_px4', 'px4_node', {'rig_file': arguments['rig']})


def may_move(arguments: Arguments) -> bool:
    """Whether commands move the rig from the start: by default only with the own simulator, and without an autopilot."""
    if arguments['enable_pointing']:
        return arguments['enable_pointing'] == 'true'
    return arguments['source'] == 'sim' and arguments['px4'] == 'false'
