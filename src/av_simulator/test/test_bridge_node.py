"""The node fed by the simulator: topics, stamps, the closed loop, and what /diagnostics say."""

import dataclasses
import multiprocessing
import socket
import time
from concurrent.futures import ProcessPoolExecutor

import cv2
import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('av_interfaces.msg', reason='needs the built workspace')
pytest.importorskip('av_sim_bridge.nodes.bridge_node_parameters', reason='needs the built workspace')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.qos import QoSProfile  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image, Imu  # noqa: E402
from udp_ports import free_ports  # noqa: E402
from vision_msgs.msg import Detection2DArray  # noqa: E402

from av_common.config_files import find_config  # noqa: E402
from av_common.qos import PICTURE, RESULT, STREAM  # noqa: E402
from av_common.stamps import to_seconds  # noqa: E402
from av_interfaces.msg import AudioFrame, PointingCommand  # noqa: E402
from av_sim_bridge.nodes.bridge_node import BridgeNode, decode_picture  # noqa: E402
from av_sim_bridge.wire.image import EncodedImage, encode_image  # noqa: E402
from av_simulator.run import open_world  # noqa: E402
from av_simulator.scenario import load_scenario  # noqa: E402
from av_simulator.simulator import Simulator, WireOptions  # noqa: E402
from av_simulator.trajectories import Static  # noqa: E402

pytestmark = pytest.mark.system
TOPICS = {'audio/frames': (AudioFrame, STREAM), 'camera/image_raw': (Image, PICTURE),
          'camera/camera_info': (CameraInfo, RESULT), 'odometry': (Odometry, RESULT), 'truth/rig': (Odometry, RESULT),
          'truth/target': (Odometry, RESULT), 'truth/target_3': (Odometry, RESULT), 'imu': (Imu, STREAM),
          'detections': (Detection2DArray, RESULT), 'camera/depth/image_raw': (Image, PICTURE),
          '/diagnostics': (DiagnosticArray, RESULT)}


class Rig:
    """A bridge node and a listener to all that it says."""

    def __init__(self, ports, depth_port=0):
        numbers = dataclasses.asdict(ports) | {'depth': depth_port}
        settings = {f'{name}_port': port for name, port in numbers.items()} | {
            'oracle_detections': True, 'stale_after': 0.5, 'targets': 2}
        arguments = [text for name, value in settings.items() for text in ('-p', f'{name}:={value}')]
        rclpy.init(args=['--ros-args', *arguments])
        self.node, self.listener = BridgeNode(), rclpy.create_node('listener')
        self.heard = {name: [] for name in TOPICS}
        for name, (kind, qos) in TOPICS.items():
            # Deep, so that a machine that stalls loses nothing between node and test.
            deep = QoSProfile(depth=2000, reliability=qos.reliability, durability=qos.durability)
            self.listener.create_subscription(kind, name, self.heard[name].append, deep)
        self.commander = self.listener.create_publisher(PointingCommand, 'pointing/command', RESULT)
        self.executor = rclpy.executors.SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.listener)

    def spin(self, seconds, command=None):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
            if command is not None:
                self.commander.publish(command)

    def spin_while_coming(self):
        """Until nothing but diagnostics has come for half a second."""
        before = -1
        while (now := sum(len(messages) for name, messages in self.heard.items() if name != '/diagnostics')) != before:
            before = now
            self.spin(0.5)

    def status(self):
        return self.heard['/diagnostics'][-1].status[0]

    def close(self):
        self.node.close()
        self.node.destroy_node()
        self.listener.destroy_node()
        rclpy.shutdown()


def simulate(scenario, options):
    """Four seconds of a scenario on the wire; what was sent."""
    simulator = Simulator(open_world(scenario), options)
    simulator.run(4.0)
    simulator.close()
    return simulator.counts


@pytest.fixture(scope='module')
def rig():
    """A bridge that has been spun without a simulator, with one for three seconds, and with garbage."""
    ports = free_ports()
    bridge = Rig(ports, ports.depth)
    scenario = load_scenario(find_config('two_drones', 'scenarios'))
    ahead = dataclasses.replace(scenario.targets[0], trajectory=Static((8.0, 0.5, 3.0)))
    scenario = dataclasses.replace(scenario, targets=(ahead, scenario.targets[1]))
    bridge.spin(2.0)
    bridge.alone = bridge.status()
    # A process of its own, as outside of tests: two threads of one interpreter slow each other down to a fifth.
    with ProcessPoolExecutor(1, multiprocessing.get_context('spawn')) as processes:
        simulator = processes.submit(simulate, scenario, WireOptions(ports=ports, audio_header=True, renderer='painter'))
        while not simulator.done():
            bridge.spin(0.2, PointingCommand(mode=PointingCommand.MODE_TRACK, move_body=True, yaw_rate=0.3))
    bridge.spin_while_coming()
    bridge.fed = {name: list(messages) for name, messages in bridge.heard.items()}
    bridge.sent = simulator.result()
    source = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    picture, depth = np.zeros((48, 64, 3), np.uint8), np.full((48, 64), 65_535, np.uint16)
    depth[10, 20] = 1234
    for port, layer in ((ports.image, picture), (ports.depth, depth), (ports.depth, picture)):
        image = EncodedImage(5.0, cv2.imencode('.png', layer)[1].tobytes())
        source.sendto(encode_image(image)[0], ('127.0.0.1', port))
    bridge.spin(0.5)
    for port in dataclasses.astuple(ports):
        for size in (0, 3, 40, 168, 6000, 60_000):
            source.sendto(np.random.default_rng(size).bytes(size), ('127.0.0.1', port))
    source.close()
    bridge.spin(1.5)
    yield bridge
    bridge.close()


def test_without_a_simulator_the_node_says_so(rig):
    assert rig.alone.level == rig.alone.WARN
    assert 'no data from the simulator' in rig.alone.message


def test_everything_is_published(rig):
    counts = {name: len(messages) for name, messages in rig.fed.items()}
    assert counts['audio/frames'] >= 20
    assert counts['odometry'] == counts['truth/rig'] >= 380
    assert counts['truth/target'] >= 380 and counts['truth/target_3'] >= 380 and counts['imu'] >= 300
    assert counts['detections'] >= 0.9 * rig.sent.images
    sound = rig.fed['audio/frames']
    assert {(message.sample_rate, message.channels) for message in sound} == {(48_000, 2)}
    assert sum(len(message.samples) for message in sound) == 2 * rig.sent.audio_frames
    assert rig.node._ring.overwritten == 0


def test_stamps_are_capture_times(rig):
    stamps = np.array([to_seconds(message.header.stamp) for message in rig.fed['audio/frames']])
    samples = np.array([message.first_sample for message in rig.fed['audio/frames']])
    # On a machine that stalls, the simulator may have to begin its schedule anew: once, not always.
    assert np.mean(np.abs(np.diff(stamps) - np.diff(samples) / 48_000) < 5e-3) > 0.9
    reports = {to_seconds(message.header.stamp) for message in rig.fed['detections']}
    assert all(to_seconds(message.header.stamp) in reports for message in rig.fed['camera/image_raw'])


def test_the_oracle_is_marked(rig):
    seen = [message for message in rig.fed['detections'] if message.detections]
    assert seen
    detection = seen[0].detections[0]
    assert (detection.id, detection.results[0].hypothesis.class_id) == ('oracle', 'drone')
    assert 0.05 <= detection.results[0].hypothesis.score <= 1.0


def test_commands_turn_the_rig(rig):
    assert rig.sent.commands > 10
    assert rig.fed['odometry'][-20].twist.twist.angular.z == pytest.approx(0.3, abs=1e-3)
    assert rig.fed['imu'][-20].angular_velocity.z == pytest.approx(0.3, abs=1e-3)
    assert rig.fed['imu'][-20].linear_acceleration.z == pytest.approx(9.80665, abs=1e-3)


def test_depth_carries_the_stamp_of_its_picture(rig):
    """In mm, 0 where there is none (REP 118); a picture on its port is none."""
    (depth,) = rig.heard['camera/depth/image_raw']
    picture = next(message for message in rig.heard['camera/image_raw'] if message.height == 48)
    assert depth.header == picture.header and depth.encoding == '16UC1' and depth.step == 128
    values = np.frombuffer(depth.data, np.uint16).reshape(48, 64)
    assert values[10, 20] == 1234 and np.count_nonzero(values) == 1


def test_garbage_is_counted_and_the_node_lives(rig):
    values = {entry.key: entry.value for entry in rig.status().values}
    for name in ('image', 'rig_truth', 'target_truth', 'imu', 'time_sync'):
        assert int(values[f'{name} malformed']) >= 5, name
    assert rig.node.is_active


@pytest.mark.parametrize('data', [b'', b'no picture', b'\xff\xd8\xff\xe0' + bytes(100)])
def test_what_is_no_picture_is_a_value_error(data):
    with pytest.raises(ValueError, match='image'):
        decode_picture(data)
