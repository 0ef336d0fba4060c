"""Functions shared by the launch files: arguments, the rig's nodes, and the guard of a run."""

from __future__ import annotations

import math
import os
import signal
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

from ament_index_python.packages import (
    PackageNotFoundError,
    get_package_prefix,
    get_package_share_directory,
)
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    GroupAction,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
)
from launch.event_handlers import OnShutdown
from launch.events import Shutdown
from launch_ros.actions import Node

from av_bringup import guard
from av_bringup.security.keystore import check_enclave
from av_bringup.security.policy import PATH
from av_bringup.supervision import RESPAWN
from av_common.files import nearest
from av_common.launched import RUN_FOLDER
from av_common.microphone_array import MicrophoneArray
from av_common.parameters import check_parameter_file, parameter_names
from av_common.rig import CAMERAS, camera_topic, load_rig

CONFIG = Path(get_package_share_directory('av_bringup')) / 'config'
DDS_VARIABLE, MOST_PARTICIPANTS = 'CYCLONEDDS_URI', 32
BAG_NAME = '%Y%m%d-%H%M%S.mcap'  # of recordings that the page begins
MONITOR_PACKAGE, VIEW_PACKAGE = 'av_evaluation', 'av_view'
CAMERA_TOPICS = ('camera/image_raw', 'camera/image_raw/compressed', 'camera/depth/image_raw', 'camera/camera_info',
                 'detections', 'detections/image', 'visibility', 'imu/data_raw')  # each camera has its own
BAG_TIME = 'bag time'  # among the arguments of nodes whose time is that of a player
Arguments = Mapping[str, str]
# Default (None: must be given), description, choices (None: anything).
Declarations = Mapping[str, tuple[str | None, str, list[str] | None]]
RIG_ARGUMENTS: Declarations = {
    'classes': ('', 'classes of the model that count as the target, separated by commas', None),
    'rig': (str(CONFIG / 'rig.yaml'), 'description of the rig: array, camera and their poses', None),
    'array': ('', "an array file instead of the rig's", None),
    'params': ('', 'a parameter file that overrides config/rig_params.yaml', None),
    'namespace': ('', 'namespace of all nodes, so that several rigs run side by side', None),
    'monitor': ('auto', f'status line and table of results, needs {MONITOR_PACKAGE}; auto: where it is installed',
                ['auto', 'true', 'false']),
    'out': ('', 'folder for the table, the plot and the data of the run, needs the monitor; empty: none', None),
    'record': ('', 'record the topics to this bag (mcap), needs av_bags; empty: no bag', None),
    'bags': ('', 'folder of recordings that the page begins and opens, with view_control', None),
    'view': ('false', f'show the rig in browsers: print the address of a page, needs {VIEW_PACKAGE}', ['true', 'false']),
    'view_control': ('false', 'the page may also control the rig, with a token that the terminal shows', ['true', 'false']),
    'security': ('', 'a keystore of `ros2 run av_bringup security`: only nodes with its keys take part; empty: all', None),
}


class MissingPackageError(RuntimeError):
    """A package that a launch argument needs is not installed."""

    def __init__(self, package: str, argument: str, remedy: str = '') -> None:
        """The message names both.

        Parameters:
            package: name of the missing package
            argument: the launch argument as given, such as `record:=flight.mcap`
            remedy: instruction for its installation; empty for a package of this workspace
        """
        super().__init__(f'{argument} needs the package {package}, which is not installed'
                         + (f': {remedy}' if remedy else ''))


def describe(declarations: Declarations, start: Callable[[Arguments], list[LaunchDescriptionEntity]]) -> LaunchDescription:
    """The launch description whose processes depend on the values of the arguments.

    Parameters:
        declarations: the launch arguments by name
        start: function from the values of the arguments to the processes and event handlers
    """
    def begin(context: LaunchContext) -> list[LaunchDescriptionEntity]:
        check_names(context, declarations)
        arguments = {name: at_home(name, context.launch_configurations[name]) for name in declarations}
        folder = mkdtemp(prefix='av_rig_')
        try:
            entities = start({**arguments, RUN_FOLDER: folder})
            if arguments['params']:
                readers = [node.full_name for node in launched_nodes(entities)]
                entities += [LogInfo(msg=note) for note in check_parameter_file(arguments['params'], readers)]
        except BaseException:
            rmtree(folder)
            raise
        entities.append(guard_process(folder))
        environment = [SetEnvironmentVariable(RUN_FOLDER, folder), *participants(entities)]
        return [GroupAction([*environment, interrupt_with_launch(entities), *entities])]
    declared = [DeclareLaunchArgument(name, default_value=default, description=text, choices=choices)
                for name, (default, text, choices) in declarations.items()]
    return LaunchDescription([*declared, OpaqueFunction(function=begin)])


def check_names(context: LaunchContext, declarations: Declarations) -> None:
    """Raise ValueError for an argument that this launch file does not have, which launch would ignore.

    The command line is only checked where it names this file: a launch file of others, which includes it, has arguments of its
    own.
    """
    file = Path(context.get_locals_as_dict().get('current_launch_file_path', ''))    # none where a program runs the description
    named = any(Path(word).name == file.name and (Path(word).resolve() == file.resolve() or package == file.parent.parent.name)
                for package, word in pairwise(sys.argv))
    for name in (word.partition(':=')[0] for word in context.argv if ':=' in word):
        if named and name not in declarations:
            raise ValueError(f'{name}:= is no argument of {file.name}, the nearest is {nearest(name, declarations)}:=')


class LaunchedNode(Node):
    """A node of the suite, which reads the user's parameter file.

    Attributes:
        full_name: with its namespace.

    Parameters:
        arguments: values of the launch arguments.
        executable: name of the program.
        name: the node's name; empty for the program's.
        options: further arguments of launch_ros.actions.Node.

    Raises ValueError for a namespace that is no name.
    """

    def __init__(self, arguments: Arguments, executable: str, name: str = '', **options: Any) -> None:
        self.full_name = '/'.join(['', *filter(None, arguments['namespace'].split('/')), name or executable])
        if not PATH.fullmatch(self.full_name):
            raise ValueError(f"namespace is {arguments['namespace']!r}, expected a name of ROS such as /rig1")
        super().__init__(executable=executable, name=name or executable, namespace=arguments['namespace'],
                         additional_env=security(arguments, self.full_name), **options)


def launched_nodes(entities: Iterable[LaunchDescriptionEntity]) -> list[LaunchedNode]:
    """The nodes among the entities of a launch."""
    return [entity for entity in entities if isinstance(entity, LaunchedNode)]


def participants(entities: Iterable[LaunchDescriptionEntity]) -> list[LaunchDescriptionEntity]:
    """What lets each node be a participant of DDS, and tools beside them: as it comes, Cyclone DDS has 32 in a domain."""
    if DDS_VARIABLE in os.environ:
        return []
    profile = f'file://{CONFIG}/dds/local.xml'
    count = len(launched_nodes(entities))
    note = LogInfo(msg=f'{count} nodes in one ROS domain: in shells for further ones, {DDS_VARIABLE}={profile}')
    return [SetEnvironmentVariable(DDS_VARIABLE, profile), *([note] if count >= MOST_PARTICIPANTS else [])]


def number(arguments: Arguments, name: str, expected: str, low: float = -math.inf, high: float = math.inf) -> float:
    """The value of an argument as a finite number. Raises ValueError with its name for anything else.

    Parameters:
        arguments: values of the launch arguments.
        name: of the argument.
        expected: what it is, for the message.
        low, high: the least and the largest value.
    """
    try:
        value = float(arguments[name])
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and low <= value <= high):
        raise ValueError(f'{name} is {arguments[name]!r}, expected {expected}')
    return value


def whole_number(arguments: Arguments, name: str, low: float = -math.inf, high: float = math.inf) -> int:
    """The same as a whole number."""
    expected = 'a whole number' + (f' from {low} to {high}' if math.isfinite(high) else '')
    value = number(arguments, name, expected, low, high)
    if value != int(value):
        raise ValueError(f'{name} is {arguments[name]!r}, expected {expected}')
    return int(value)


def make_folder(name: str, folder: str) -> None:
    """Make a folder for results before the run that gives them. Raises ValueError where nothing can be written to it.

    Parameters:
        name: of the launch argument.
        folder: its value.
    """
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f'{name}:={folder} cannot be made: {error.strerror}') from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ValueError(f'{name}:={folder} cannot be written')


def at_home(name: str, value: str) -> str:
    """The value of an argument; ~ at its beginning is the user's home, which a shell leaves alone in `audio:=~/x.wav`."""
    try:
        return str(Path(value).expanduser()) if value.startswith('~') else value
    except RuntimeError as error:    # the home of nobody
        raise ValueError(f'{name} is {value!r}: {error}') from error


def guard_process(folder: str) -> ExecuteProcess:
    """The guard, which ends the other processes where the launch is killed.

    Parameters:
        folder: folder of the run, the value of RUN_FOLDER in the environment of those processes.
    """
    command = [sys.executable, '-I', '-S', guard.__file__, f'{RUN_FOLDER}={folder}', str(os.getpid())]
    # It ends last, after processes that take their time to close files.
    return ExecuteProcess(cmd=command, name='guard', output='log', sigterm_timeout='60', **RESPAWN)


def interrupt_with_launch(entities: Iterable[LaunchDescriptionEntity]) -> LaunchDescriptionEntity:
    """The handler that passes on a SIGINT of the launch alone; launch expects that Ctrl-C has reached its processes.

    Parameters:
        entities: of the launch, whose processes are interrupted; a second SIGINT does them no harm.
    """
    processes = [entity for entity in entities if isinstance(entity, ExecuteProcess)]

    def interrupt(event: Shutdown, context: LaunchContext) -> None:
        for process in processes if event.due_to_sigint else ():
            with suppress(ProcessLookupError, KeyError, TypeError):    # has ended, or has not started
                os.kill(process.process_details['pid'], signal.SIGINT)
    return RegisterEventHandler(OnShutdown(on_shutdown=interrupt))


def is_installed(package: str) -> bool:
    """Whether a ROS package is in one of the prefixes of AMENT_PREFIX_PATH."""
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True


def require(argument: str, *packages: str) -> None:
    """Raise MissingPackageError where one of the packages that an argument needs is not installed."""
    for package in packages:
        if not is_installed(package):
            raise MissingPackageError(package, argument)


def rig_node(arguments: Arguments, package: str, executable: str, parameters: dict, **options: object) -> LaunchedNode:
    """A node with the shipped parameters, those of this launch, and the user's file, where later values replace earlier ones.

    Parameters:
        arguments: values of the launch arguments
        package: the node's package
        executable: name of the program, which is the node's name, too
        parameters: parameters that this launch sets
        options: further arguments of LaunchedNode

    Raises ValueError for a value that the node would refuse.
    """
    try:
        parameter_names(f'{package}.nodes.{executable}', parameters)
    except ValueError as error:
        raise ValueError(f'{executable}: {error}') from error
    time = {'use_sim_time': True} if BAG_TIME in arguments else {}
    files = [str(CONFIG / 'rig_params.yaml'), {**parameters, **time}, *filter(None, [arguments['params']])]
    return LaunchedNode(arguments, executable, package=package, parameters=files, **{'output': 'log', **RESPAWN, **options})


def security(arguments: Arguments, enclave: str) -> dict[str, str]:
    """The environment in which a node uses its enclave of the keystore, empty without one. Raises KeystoreError.

    Parameters:
        arguments: values of the launch arguments
        enclave: the node's full name
    """
    if not arguments['security']:
        return {}
    keystore = Path(arguments['security']).resolve()
    check_enclave(keystore, enclave)
    return {'ROS_SECURITY_KEYSTORE': str(keystore), 'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_STRATEGY': 'Enforce',
            'ROS_SECURITY_ENCLAVE_OVERRIDE': enclave}


def monitor_nodes(arguments: Arguments, duration: float = 0.0) -> list[Node]:
    """The monitor, or an empty list where none is wanted or none is installed.

    Parameters:
        arguments: values of the launch arguments.
        duration (s): after which it ends; 0 for never.

    Raises MissingPackageError where an argument asks for the monitor, ValueError where `out` and `monitor` disagree, and where
    the folder of the results cannot be written.
    """
    monitor, out = arguments['monitor'], arguments['out']
    if monitor == 'false':
        if out:
            raise ValueError(f'out:={out} needs the monitor, which monitor:=false leaves out')
        return []
    if monitor == 'true' or out:
        require(f'out:={out}' if out else 'monitor:=true', MONITOR_PACKAGE)
    elif not is_installed(MONITOR_PACKAGE):
        return []
    if out:
        make_folder('out', out)
    return [rig_node(arguments, MONITOR_PACKAGE, 'monitor_node', {'out': out, 'duration': duration},
                     output='screen', sigterm_timeout='20', respawn=False)]


def audio_node(arguments: Arguments, parameters: dict) -> LaunchedNode:
    """The sound of the rig's microphones, in the frame of its description.

    Parameters:
        arguments: values of the launch arguments.
        parameters: parameters that this launch sets.
    """
    return rig_node(arguments, 'av_audio', 'audio_node', {'frame_id': load_rig(arguments['rig']).array.frame, **parameters})


def doa_node(arguments: Arguments) -> Node:
    """Direction of arrival. Raises ValueError or OSError for an array file that cannot be used."""
    array = array_file(arguments)
    MicrophoneArray.load(array)
    return rig_node(arguments, 'av_audio', 'doa_node', {'array_file': array})


def array_file(arguments: Arguments) -> str:
    """The array file of the argument `array`, or of the rig's description."""
    return arguments['array'] or str(load_rig(arguments['rig']).array.file)


def detector_nodes(arguments: Arguments) -> list[LaunchedNode]:
    """A detector for each camera of the rig: the first with the model given, others with the shipped one of their kind."""
    model = '' if arguments['model'] == 'shipped' else arguments['model']
    classes = {'keep_classes': arguments['classes'].split(',')} if arguments['classes'] else {}
    given = {'model': model, **classes}
    return [camera_node(arguments, 'detector_node', camera, {
        'camera_kind': mount.images, **(given if camera == 'camera' else {})})
        for camera, mount in load_rig(arguments['rig']).cameras.items()]


def camera_nodes(arguments: Arguments, parameters: dict) -> list[LaunchedNode]:
    """The node of each camera of the rig, with the size and the field of view of its description.

    Parameters:
        arguments: values of the launch arguments.
        parameters: parameters that this launch sets.
    """
    return [camera_node(arguments, 'camera_node', camera, {
        'frame_id': mount.optical_frame, 'width': mount.width, 'height': mount.height,
        'horizontal_fov_deg': mount.horizontal_fov_deg,
        **({'pixel_format': 'Y16'} if (mount.kind, mount.palette) == ('thermal', 'raw') else {}), **parameters})
        for camera, mount in load_rig(arguments['rig']).cameras.items()]


def camera_node(arguments: Arguments, executable: str, camera: str, parameters: dict) -> LaunchedNode:
    """A node of one of the rig's cameras: of the second one, its name and all topics but the body's begin with the camera's.

    Parameters:
        arguments: values of the launch arguments.
        executable: name of the program.
        camera: one of `Rig.cameras`.
        parameters: parameters that this launch sets.
    """
    name = executable if camera == CAMERAS[0] else f'{camera}_{executable.removeprefix("camera_")}'
    return rig_node(arguments, 'av_vision', executable, parameters, name=name,
                    remappings=[(topic, other) for topic in CAMERA_TOPICS if (other := camera_topic(camera, topic)) != topic])


def recorder_nodes(arguments: Arguments) -> list[Node]:
    """The recorder; with `bags` alone it waits until the page starts it. Empty without both.

    Raises MissingPackageError, or FileExistsError for a bag that exists.
    """
    record, bags = arguments['record'], arguments['bags']
    if not record and not bags:
        return []
    require(f'record:={record}' if record else f'bags:={bags}', 'av_bags')
    path = record or str(Path(bags) / BAG_NAME)
    if record and Path(named := datetime.now().strftime(record)).exists():
        raise FileExistsError(f'record:={record}: {named} exists already, expected a new file such as flight_%H%M%S.mcap')
    return [rig_node(arguments, 'av_bags', 'recorder_node', {'path': path, 'autostart': bool(record)})]


def view_nodes(arguments: Arguments) -> list[Node]:
    """The page for browsers, or an empty list without `view`. Raises MissingPackageError or ValueError."""
    if arguments['view'] != 'true':
        if arguments['view_control'] == 'true':
            raise ValueError('view_control:=true needs view:=true')
        return []
    require('view:=true', VIEW_PACKAGE)
    control = {'view_control': arguments['view_control'] == 'true', 'bags': arguments['bags']}
    return [rig_node(arguments, VIEW_PACKAGE, 'view_node', {**control}, output='screen')]
