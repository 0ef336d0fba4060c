"""Prints the topics and services of a node as JSON: `python3 node_endpoints.py NODE VARIANT FOLDER`, in a process of its own.

The node is configured and activated. Its variants together have everything that it ever has.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
import types
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import entry_points
from pathlib import Path

import cv2
import numpy as np
import rclpy
import soundfile
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rosidl_runtime_py.utilities import get_message
from std_msgs.msg import String
from websockets.sync.client import connect

from av_bags.topics import KINDS
from av_bags.writer import BagWriter
from av_common.node import RigNode

CONFIG = Path(__file__).resolve().parent.parent / 'config'
RIG, RIG_GIMBAL, RIG_TWO_CAMERAS = (str(CONFIG / f'{name}.yaml') for name in ('rig', 'rig_gimbal', 'rig_two_cameras'))
ARRAY = str(sorted((CONFIG / 'arrays').glob('*.yaml'))[0])
# Parameters with which a node has everything that it can have, in one or several runs.
VARIANTS: dict[str, list[dict]] = {
    'audio_node': [{'file': '{folder}/sound.wav'}],
    'bridge_node': [{'rig_file': RIG, 'oracle_detections': True, 'targets': 2},
                    {'rig_file': RIG_GIMBAL, 'follow_odometry': True},
                    {'rig_file': RIG_TWO_CAMERAS, 'oracle_detections': True}],
    'camera_node': [{'file': '{folder}/images', 'depth': True, 'imu': True}],
    'detector_node': [{'compressed': True, 'camera_height': 1.0}, {'compressed': False}],
    'doa_node': [{'array_file': ARRAY, 'ego_rotor_blades': 2}],
    'fusion_node': [{'use_cues': True}, {'rig_file': RIG_TWO_CAMERAS}],
    'network_node': [{'rigs': ['left', 'right'], 'positions': [0.0] * 6, 'pose_sources': ['odometry', 'fix'], 'cue': True,
                      'datum': {'known': True, 'latitude': 48.0, 'longitude': 11.0, 'altitude': 500.0}}],
    'player_node': [{'bag': '{folder}/bag.mcap', 'only': 'all'}],
    'pointing_node': [{'follow_cues': True}],
    'px4_node': [{'offboard': True}],
    'recorder_node': [{'path': '{folder}/recording.mcap'}],
    'report_node': [{'positions': True}],
    'rig_frames_node': [{'rig_file': RIG_GIMBAL}],
    'view_node': [{'port': 0}],
}


def variants(name: str) -> list[dict]:
    """The parameters with which a node is started."""
    return VARIANTS.get(name, [{}])


class AnyMessages(types.ModuleType):
    """Stands for a package of messages that need not be installed: names of topics do not depend on them."""

    def __getattr__(self, name: str) -> type:
        if name.startswith('__'):
            raise AttributeError(name)
        return String


def node_class(name: str) -> type[RigNode]:
    """The class of the program `name`."""
    program, = entry_points(group='console_scripts', name=name)
    module = importlib.import_module(program.module)
    found, = (value for value in vars(module).values()
              if isinstance(value, type) and issubclass(value, RigNode) and value.__module__ == module.__name__)
    return found


def endpoints(node: Node) -> dict[str, set[str]]:
    """Names of what a node publishes, subscribes, serves and calls, from the ROS graph, which is late."""
    name, namespace = node.get_name(), node.get_namespace()
    created = {'publish': {publisher.topic_name for publisher in node.publishers},
               'subscribe': {subscription.topic_name for subscription in node.subscriptions},
               'reply': {node.resolve_service_name(service.srv_name) for service in node.services},
               'request': {node.resolve_service_name(client.srv_name) for client in node.clients}}
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        found = {kind: {topic for topic, _ in ask(name, namespace)} for kind, ask in (
            ('publish', node.get_publisher_names_and_types_by_node), ('subscribe', node.get_subscriber_names_and_types_by_node),
            ('reply', node.get_service_names_and_types_by_node), ('request', node.get_client_names_and_types_by_node))}
        if all(names <= found[kind] for kind, names in created.items()):
            return found
        time.sleep(0.05)
    raise TimeoutError(f'the graph shows {found}, not {created}')


def write_sound_and_image(folder: Path) -> None:
    """Recordings instead of sensors."""
    soundfile.write(folder / 'sound.wav', np.zeros((4800, 2)), 48_000)
    (folder / 'images').mkdir()
    cv2.imwrite(str(folder / 'images' / '0.png'), np.zeros((48, 64, 3), np.uint8))


def write_bag(file: Path) -> None:
    """A bag with a message on each topic that can be played."""
    with BagWriter(file) as bag:
        for name, kinds in KINDS.items():
            topic = name if name.startswith('/') else f'/{name}'
            bag.add_topic(topic, kinds[0])
            bag.write(topic, 1_000_000_000, serialize_message(get_message(kinds[0])()))


@contextmanager
def everything_published() -> Iterator[None]:
    """Have a second node that publishes all topics of the rig."""
    other = Node('everything')
    kinds = {name: found[0] for name, found in KINDS.items()}
    beside = {'/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray', 'tracks': 'av_interfaces/msg/WorldTrackArray',
              'tf': 'tf2_msgs/msg/TFMessage', 'view/markers': 'visualization_msgs/msg/MarkerArray'}
    for name, kind in (kinds | beside).items():
        other.create_publisher(get_message(kind), name, QoSProfile(depth=1))
    yield
    other.destroy_node()


def wait_for_recording(node: RigNode) -> None:
    """Spin until the recorder has found the topics."""
    deadline = time.monotonic() + 60.0
    while len(list(node.subscriptions)) < len(KINDS) + 3 and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)


def wait_for_a_watch(node: RigNode) -> None:
    """Look at the page's rig, and spin until the node has subscribed to its true poses, and to tracks of several rigs."""
    with connect(f'ws://127.0.0.1:{node.server.port}/feed', proxy=None) as viewer:
        viewer.send('{"do": "watch"}')
        deadline = time.monotonic() + 60.0
        while not {'/truth/rig', '/tracks'} <= {topic for topic, _ in node.get_subscriber_names_and_types_by_node(
                node.get_name(), node.get_namespace())}:
            assert time.monotonic() < deadline
            rclpy.spin_once(node, timeout_sec=0.1)


def main(name: str, variant: str, folder: str) -> None:
    """Print the endpoints of a node.

    Parameters:
        name: the node's name.
        variant: index of its parameters in VARIANTS.
        folder: an empty folder.
    """
    sys.modules['px4_msgs.msg'] = AnyMessages('px4_msgs.msg')
    sys.modules['px4_msgs'] = types.ModuleType('px4_msgs')
    sys.modules['px4_msgs'].msg = sys.modules['px4_msgs.msg']
    write_bag(Path(folder, 'bag.mcap'))
    write_sound_and_image(Path(folder))
    values = {key: value.format(folder=folder) if isinstance(value, str) else value
              for key, value in variants(name)[int(variant)].items()}
    parameters = Path(folder, 'parameters.yaml')
    parameters.write_text(json.dumps({f'/{name}': {'ros__parameters': {'autostart': False, **values}}}))
    rclpy.init(args=['--ros-args', '--params-file', str(parameters)])
    print(json.dumps({kind: sorted(names) for kind, names in run(node_class(name)()).items()}))
    rclpy.shutdown()


def run(node: RigNode) -> dict[str, set[str]]:
    """All endpoints of a node, which is configured and, where its sensors are here, activated."""
    with everything_published():
        node.trigger_configure()
        configured = endpoints(node)
        node.trigger_activate()
        if node.get_name() == 'recorder_node':
            wait_for_recording(node)
        if node.get_name() == 'view_node':
            wait_for_a_watch(node)
        node._time_source.ros_time_is_active = True  # as with use_sim_time from the start
        active = endpoints(node)
    node.close()
    node.destroy_node()
    return {kind: configured[kind] | active[kind] for kind in active}


if __name__ == '__main__':
    main(*sys.argv[1:])
