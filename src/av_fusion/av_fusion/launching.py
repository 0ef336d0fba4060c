"""What the launch files have in common: their arguments, the rig's nodes, and how a run ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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

from av_common.rig import load_rig

CONFIG = Path(get_package_share_directory('av_fusion')) / 'config'
Arguments = Mapping[str, str]
# Default (None: must be given), description, choices (None: anything).
Declarations = Mapping[str, tuple[str | None, str, list[str] | None]]
RIG_ARGUMENTS: Declarations = {
    'classes': ('', 'classes of the model to be taken for the target, separated by commas', None),
    'rig': (str(CONFIG / 'rig.yaml'), 'description of the rig: array, camera and where they sit', None),
    'array': ('', "an array file other than the rig's", None),
    'params': ('', 'a parameter file read after config/rig_params.yaml', None),
    'namespace': ('', 'a namespace, so that several rigs run side by side', None),
    'out': ('', 'a folder for the table, the picture and figures; empty writes none', None),
    'record': ('', 'record the topics to this bag (mcap)', None),
}


def describe(declarations: Declarations, start: Callable[[Arguments], list[LaunchDescriptionEntity]]) -> LaunchDescription:
    """A launch of what `start` makes of the arguments' values."""
    def begin(context: LaunchContext) -> list[LaunchDescriptionEntity]:
        return start({name: context.launch_configurations[name] for name in declarations})
    declared = [DeclareLaunchArgument(name, default_value=default, description=text, choices=choices)
                for name, (default, text, choices) in declarations.items()]
    return LaunchDescription([*declared, OpaqueFunction(function=begin)])


def rig_node(arguments: Arguments, package: str, executable: str, parameters: dict, **options: object) -> Node:
    """A node of the rig with the shipped parameters, those of this launch, and the user's on top."""
    files = [str(CONFIG / 'rig_params.yaml'), parameters, *filter(None, [arguments['params']])]
    return Node(package=package, executable=executable, name=executable, namespace=arguments['namespace'],
                parameters=files, **{'output': 'log', **options})


def monitor_node(arguments: Arguments, parameters: dict) -> Node:
    """The status line, and at the end table and picture."""
    return rig_node(arguments, 'av_evaluation', 'monitor_node', {'out': arguments['out'], **parameters},
                    output='screen', sigterm_timeout='20')


def doa_node(arguments: Arguments, parameters: dict) -> Node:
    """Hearing, with the microphones of the file given, or of the one that the rig's description names."""
    array = arguments['array'] or str(load_rig(arguments['rig']).array.file)
    return rig_node(arguments, 'av_audio', 'doa_node', {'array_file': array, **parameters})


def detector_node(arguments: Arguments, parameters: dict) -> Node:
    """The detector, with the model given or the shipped one."""
    model = '' if arguments['model'] == 'shipped' else arguments['model']
    classes = {'keep_classes': arguments['classes'].split(',')} if arguments['classes'] else {}
    return rig_node(arguments, 'av_vision', 'detector_node', {'model': model, **classes, **parameters})


def recorder_nodes(arguments: Arguments, parameters: dict) -> list[Node]:
    """The recorder, if one is asked for."""
    given = {'path': arguments['record'], **parameters}
    return [rig_node(arguments, 'av_bags', 'recorder_node', given)] if arguments['record'] else []


def ends_with(last: Node) -> list[LaunchDescriptionEntity]:
    """The launch ends with this process; a process that ends before fails the launch: its exit code is then not 0."""
    def check(event: object, context: LaunchContext) -> None:
        if not context.is_shutdown and not (event.action is last and event.returncode == 0):
            raise RuntimeError(f'{event.process_name} ended with exit code {event.returncode} while the rig was running')
    shutdown = EmitEvent(event=Shutdown(reason='the run is over'))
    return [RegisterEventHandler(OnProcessExit(on_exit=check)),
            RegisterEventHandler(OnProcessExit(target_action=last, on_exit=[shutdown]))]
