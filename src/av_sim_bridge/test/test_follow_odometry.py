"""A rig moved by its autopilot moves in the simulator, too: `odometry` as truth on the control port."""

import socket
from pathlib import Path

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('av_sim_bridge.nodes.bridge_node_parameters', reason='needs the built workspace')

from nav_msgs.msg import Odometry  # noqa: E402
from udp_ports import free_offset  # noqa: E402

from av_common.qos import RESULT  # noqa: E402
from av_interfaces.msg import PointingCommand  # noqa: E402
from av_sim_bridge.messages import make_header, odometry_message, vehicle_state  # noqa: E402
from av_sim_bridge.nodes.bridge_node import BridgeNode  # noqa: E402
from av_sim_bridge.vehicle import VehicleState, from_truth  # noqa: E402
from av_sim_bridge.wire.ports import Ports  # noqa: E402
from av_sim_bridge.wire.rig_control import decode_rig_control  # noqa: E402
from av_sim_bridge.wire.truth import decode_truth, is_truth  # noqa: E402

STATE = VehicleState(12.5, np.array([1.0, -2.0, 3.0]), np.array([0.5, 0.25, -1.0]),
                     attitude_wxyz=np.array([0.5, -0.5, 0.5, 0.5]), rate_flu=np.array([0.1, 0.2, 0.3]))


def message(state=STATE):
    return odometry_message(make_header(state.time, 'map'), 'base_link', state)


def assert_same(state, expected):
    for name in ('position', 'velocity', 'attitude_wxyz', 'rate_flu'):
        given, wanted = getattr(state, name), getattr(expected, name)
        sign = np.sign(given @ wanted) if name == 'attitude_wxyz' else 1.0    # q and -q are one attitude
        np.testing.assert_allclose(sign * given, wanted, atol=1e-6)


def test_the_state_of_an_odometry_is_the_one_it_was_made_of():
    assert_same(vehicle_state(message()), STATE)
    assert vehicle_state(message()).time == pytest.approx(12.5)


@pytest.mark.parametrize('field, value', [('position', np.array([np.nan, 0.0, 0.0])),
                                          ('attitude_wxyz', np.zeros(4)), ('attitude_wxyz', np.full(4, np.nan))])
def test_what_is_no_pose_is_refused(field, value):
    broken = message()
    place = broken.pose.pose
    if field == 'position':
        place.position.x = float(value[0])
    else:
        place.orientation.w, place.orientation.x, place.orientation.y, place.orientation.z = map(float, value)
    with pytest.raises(ValueError, match='odometry'):
        vehicle_state(broken)


@pytest.fixture
def following():
    """A node that follows odometry, another one beside it, and the socket of a simulator's control port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        offset = free_offset()
        control.bind(('127.0.0.1', Ports().shifted(offset).control))
        control.settimeout(0.05)
        settings = {
            'port_offset': offset, 'follow_odometry': 'true',
            'rig_file': Path(__file__).resolve().parents[3] / 'config' / 'rig.yaml'}
        rclpy.init(args=['--ros-args', *(text for name, value in settings.items() for text in ('-p', f'{name}:={value}'))])
        node, other = BridgeNode(), rclpy.create_node('autopilot')
        executor = rclpy.executors.SingleThreadedExecutor()
        executor.add_node(node)
        executor.add_node(other)
        yield executor, node, other, control
        node.close()
        node.destroy_node()
        other.destroy_node()
        rclpy.shutdown()


def receive(executor, publish, control, wanted, most=2000):
    """The first datagram that `wanted` accepts, while `publish` is called; by count, not by the machine's speed."""
    for _ in range(most):
        publish()
        executor.spin_once(timeout_sec=0.05)
        try:
            datagram = control.recv(65_535)
        except TimeoutError:
            continue
        if wanted(datagram):
            return datagram
    raise AssertionError('nothing came to the control port')


@pytest.mark.system
def test_odometry_goes_to_the_simulator_and_yaw_rates_do_not(following):
    executor, node, other, control = following
    poses = other.create_publisher(Odometry, 'odometry', RESULT)
    commands = other.create_publisher(PointingCommand, 'pointing/command', RESULT)
    datagram = receive(executor, lambda: poses.publish(message()), control, is_truth)
    truth = decode_truth(datagram)
    assert truth.copter_id == 1
    assert_same(from_truth(truth), STATE)
    assert 'odometry' not in {publisher.topic_name.lstrip('/') for publisher in node.publishers}
    turn = PointingCommand(mode=PointingCommand.MODE_TRACK, move_body=True, yaw_rate=0.3, move_gimbal=True, pan=0.1, tilt=0.2)

    def give():
        turn.header.stamp = other.get_clock().now().to_msg()
        commands.publish(turn)

    command = decode_rig_control(receive(executor, give, control, lambda data: not is_truth(data)))
    assert command.yaw_rate is None
    assert (command.pan, command.tilt) == pytest.approx((0.1, 0.2))
