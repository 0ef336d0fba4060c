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

from bridge_rig import PATIENCE, BridgeRig  # noqa: E402
from machine_load import skip_figures_where_overloaded  # noqa: E402
from udp_ports import free_offset  # noqa: E402

from av_common.stamps import to_seconds  # noqa: E402
from av_interfaces.msg import PointingCommand  # noqa: E402
from av_sim_bridge.wire.image import EncodedImage, encode_image  # noqa: E402
from av_sim_bridge.wire.ports import TIME_SYNC_GROUP, Ports  # noqa: E402
from av_simulator.config_files import find_config  # noqa: E402
from av_simulator.run import open_world  # noqa: E402
from av_simulator.scenario import load_scenario  # noqa: E402
from av_simulator.simulator import Simulator, WireOptions  # noqa: E402
from av_simulator.trajectories import Static  # noqa: E402

pytestmark = pytest.mark.system


def simulate(scenario, options):
    """Four seconds of a scenario on the wire; what was sent."""
    simulator = Simulator(open_world(scenario), options)
    simulator.run(4.0)
    simulator.close()
    return simulator.counts


@pytest.fixture(scope='module')
def rig():
    """A bridge that has been spun without a simulator, with one for four seconds, and with garbage."""
    offset = free_offset()
    ports = Ports().shifted(offset)
    bridge = BridgeRig(offset)
    scenario = load_scenario(find_config('two_drones', 'scenarios'))
    ahead = dataclasses.replace(scenario.targets[0], trajectory=Static((8.0, 0.5, 3.0)))
    scenario = dataclasses.replace(scenario, targets=(ahead, scenario.targets[1]))
    bridge.spin_until_connected()
    bridge.spin_until(lambda: 'no data' in bridge.status().message, 'a report of missing data')
    bridge.alone = bridge.status()
    bridge.begin = time.time()
    # A process of its own, as outside of tests: two threads of one interpreter slow each other down to a fifth.
    with ProcessPoolExecutor(1, multiprocessing.get_context('spawn')) as processes:
        simulator = processes.submit(simulate, scenario, WireOptions(ports=ports, audio_header=True, renderer='flat'))
        while not simulator.done():
            bridge.spin(0.2, PointingCommand(mode=PointingCommand.MODE_TRACK, move_body=True, yaw_rate=0.3))
    bridge.spin_while_coming()
    bridge.end = time.time()
    bridge.fed = {name: list(messages) for name, messages in bridge.received.items()}
    bridge.received['/diagnostics'].clear()    # the next ones count all that was sent
    bridge.told = bridge.values()
    bridge.sent = simulator.result()
    source = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    image, depth = np.zeros((48, 64, 3), np.uint8), np.full((48, 64), 65_535, np.uint16)
    depth[10, 20] = 1234
    started = min(to_seconds(message.header.stamp) for message in bridge.fed['odometry'])
    while not bridge.pairs():
        assert time.time() < bridge.end + PATIENCE, 'no image with its depth'
        instant = time.time() - started
        for port, layer, later in ((ports.image, image, 0.0), (ports.depth, depth, 0.0), (ports.depth, image, 1e-3)):
            encoded = EncodedImage(instant + later, cv2.imencode('.png', layer)[1].tobytes())
            source.sendto(encode_image(encoded)[0], ('127.0.0.1', port))
        bridge.spin(0.5)
    bridge.spin_until(lambda: int(bridge.values()['depth malformed']) > 0, 'a count of what is no depth')
    bridge.undecodable = bridge.values()['depth last error']
    source.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton('127.0.0.1'))
    for name, port in vars(ports).items():
        for size in (0, 3, 40, 168, 6000, 60_000):
            host = TIME_SYNC_GROUP if name == 'time_sync' else '127.0.0.1'
            source.sendto(np.random.default_rng(size).bytes(size), (host, port))
    source.close()
    yield bridge
    bridge.close()


def test_without_a_simulator_the_node_says_so(rig):
    assert rig.alone.level == rig.alone.WARN
    assert 'no data from the simulator' in rig.alone.message


def test_everything_is_published(rig):
    """But reports of images that came too late to be dated, as it happens where the machine stalls: they are counted."""
    skip_figures_where_overloaded()
    counts = {name: len(messages) for name, messages in rig.fed.items()}
    assert counts['audio/frames'] >= 20
    assert counts['odometry'] == counts['truth/rig'] >= 380
    assert counts['truth/target'] >= 380 and counts['truth/target_3'] >= 380 and counts['imu'] >= 300
    assert counts['detections'] >= 0.9 * (rig.sent['images'] - int(rig.told['image camera undated']))
    sound = rig.fed['audio/frames']
    assert {(message.sample_rate, message.channels) for message in sound} == {(48_000, 2)}
    assert sum(len(message.samples) for message in sound) == 2 * rig.sent['audio_frames']


def test_stamps_are_capture_times(rig):
    """Of the system's clock, and the same for all that belongs to one image; test_bridge_stage.py tests how exact they are."""
    for name, messages in rig.fed.items():
        if name != '/diagnostics':
            stamps = [to_seconds(message.header.stamp) for message in messages]
            assert all(rig.begin < stamp < rig.end for stamp in stamps), name
    reports = {to_seconds(message.header.stamp) for message in rig.fed['detections']}
    assert all(to_seconds(message.header.stamp) in reports for message in rig.fed['camera/image_raw'])


def test_the_oracle_is_marked(rig):
    skip_figures_where_overloaded()
    seen = [message for message in rig.fed['detections'] if message.detections]
    assert seen
    detection = seen[0].detections[0]
    assert (detection.id, detection.results[0].hypothesis.class_id) == ('oracle', 'drone')
    assert 0.05 <= detection.results[0].hypothesis.score <= 1.0


def test_commands_turn_the_rig(rig):
    """To the commanded rate and no further; a machine that stalls for longer than a command lives lets it slow down."""
    skip_figures_where_overloaded()
    assert rig.sent['commands'] > 10 and rig.sent['refused_commands'] == 0
    assert max(message.twist.twist.angular.z for message in rig.fed['odometry']) == pytest.approx(0.3, abs=1e-3)
    assert max(message.angular_velocity.z for message in rig.fed['imu']) == pytest.approx(0.3, abs=1e-3)
    assert rig.fed['imu'][-20].linear_acceleration.z == pytest.approx(9.80665, abs=1e-3)


def test_depth_carries_the_stamp_of_its_image(rig):
    """In mm, 0 where there is none (REP 118); an image on its port is none."""
    depth = rig.pairs()[0]
    assert depth.encoding == '16UC1' and depth.step == 128
    values = np.frombuffer(depth.data, np.uint16).reshape(48, 64)
    assert values[10, 20] == 1234 and np.count_nonzero(values) == 1
    assert 'depth: uint8 in 3 dimensions, expected a PNG of 16 bit' in rig.undecodable


def test_garbage_is_counted_and_the_node_lives(rig):
    streams = ('image', 'rig_truth', 'target_truth', 'imu', 'time_sync')
    rig.spin_until(lambda: all(int(rig.values()[f'{name} malformed']) >= 5 for name in streams), 'malformed datagrams')
    assert rig.node.is_active
