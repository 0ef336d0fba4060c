"""The stage fed by a sender that shares no code with it: both headers, both truth layouts, and the sign of every axis."""

import math
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
cv2 = pytest.importorskip('cv2')

from fake_rflysim import FakeRflysim  # noqa: E402

from av_common.rig import load_rig  # noqa: E402
from av_common.stamps import to_seconds  # noqa: E402
from av_sim_bridge.stage import BridgeStage  # noqa: E402
from av_sim_bridge.wire.audio import AudioFormat  # noqa: E402
from av_sim_bridge.wire.ports import Ports  # noqa: E402

RIG = Path(__file__).resolve().parents[3] / 'config' / 'rig.yaml'
BLOCK = 1600
EPOCH = 1_700_000_000.0    # s, ROS time of the sender's zero
EAST = {'euler': (0.0, 0.0, math.pi / 2), 'quaternion': (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))}


class Bridge:
    """A stage behind ports: `received` holds the messages of each topic."""

    def __init__(self, ports):
        self.stage = BridgeStage(load_rig(RIG), AudioFormat(), targets=2, oracle_detections=True)
        self.received, self.now = defaultdict(list), EPOCH
        self._handlers = {ports.audio: self.stage.on_audio, ports.image: self.stage.on_image,
                          ports.rig_truth: self.stage.on_truth,
                          ports.target_truth: self.stage.on_truth, ports.target_truth + 2: self.stage.on_truth,
                          ports.imu: self.stage.on_imu}

    def deliver(self, port, datagram):
        for topic, message in self._handlers[port](datagram, self.now, ('127.0.0.1', 50_000)):
            self.received[topic].append(message)


@pytest.fixture(scope='module')
def received():
    """What the bridge makes of two seconds: the right microphone hears everything five samples later."""
    ports = Ports()
    bridge = Bridge(ports)
    fake = FakeRflysim(ports, bridge.deliver)
    rng = np.random.default_rng(1)
    noise = rng.integers(-8000, 8000, 61 * BLOCK)
    jpeg = cv2.imencode('.png', rng.integers(0, 255, (240, 320, 3), np.uint8))[1].tobytes()    # several datagrams
    for k in range(60):
        now = k / 30
        bridge.now = EPOCH + now
        left = noise[k * BLOCK + 5:(k + 1) * BLOCK + 5]
        fake.sound(np.stack([left, noise[k * BLOCK:(k + 1) * BLOCK]], axis=1))
        fake.truth(ports.rig_truth, 1, now, (1.0, 2.0, -3.0), (4.0, 0.0, -0.5), **EAST, rate=(0.1, 0.2, 0.3))
        fake.short_truth(ports.target_truth, 2, now, (10.0, -20.0, -5.0), (0.0, 3.0, 1.0), (0.0, 0.2, 0.0))
        fake.truth(ports.target_truth + 2, 3, now, (7.0, 8.0, -9.0), (0.0,) * 3, **EAST, rate=(0.0,) * 3)
        fake.imu(k, now, (0.5, 0.25, -9.75), (0.1, 0.2, 0.3))
        if k % 6 == 0:
            fake.image(jpeg, now, None if k < 30 else k)
            fake.oracle((2, 0.75, 10.0, 20.0, 30.0, 60.0))
    return bridge.received


def xyz(vector):
    return vector.x, vector.y, vector.z


def test_the_rig_in_enu_and_flu(received):
    """It looks east, flies north (to its left) and climbs; rolls right, pitches up, turns right."""
    rig = received['odometry'][-1]
    assert xyz(rig.pose.pose.position) == pytest.approx((2.0, 1.0, 3.0))
    assert abs(rig.pose.pose.orientation.w) == pytest.approx(1.0, abs=1e-6)
    assert xyz(rig.twist.twist.linear) == pytest.approx((0.0, 4.0, 0.5), abs=1e-5)
    assert xyz(rig.twist.twist.angular) == pytest.approx((0.1, -0.2, -0.3), abs=1e-6)
    assert xyz(received['imu'][-1].linear_acceleration) == pytest.approx((0.5, -0.25, 9.75))
    assert xyz(received['imu'][-1].angular_velocity) == pytest.approx((0.1, -0.2, -0.3), abs=1e-6)


def test_several_vehicles_in_either_layout(received):
    """The short one looks north, nose up by 0.2 rad, flies east and sinks."""
    short, long = received['truth/target'][-1], received['truth/target_3'][-1]
    assert xyz(short.pose.pose.position) == pytest.approx((-20.0, 10.0, 5.0))
    q = short.pose.pose.orientation
    ahead = (1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y + q.w * q.z), 2 * (q.x * q.z - q.w * q.y))
    assert ahead == pytest.approx((0.0, math.cos(0.2), math.sin(0.2)), abs=1e-6)
    speed = short.twist.twist.linear    # to the right; what sinks also goes back along a nose that is up
    assert xyz(speed) == pytest.approx((-math.sin(0.2), -3.0, -math.cos(0.2)), abs=1e-5)
    assert xyz(long.pose.pose.position) == pytest.approx((8.0, 7.0, 9.0))


def test_images_with_either_header_and_their_boxes(received):
    assert len(received['camera/image_raw']) == len(received['detections']) == 10
    for image, found in zip(received['camera/image_raw'], received['detections'], strict=True):
        assert image.header == found.header
    box = received['detections'][-1].detections[0].bbox
    assert (box.center.position.x, box.center.position.y, box.size_x, box.size_y) == (20.0, 40.0, 20.0, 40.0)


def test_stamps_are_the_senders_times(received):
    for topic, rate in {'odometry': 30, 'truth/target': 30, 'imu': 30, 'camera/image_raw': 5}.items():
        stamps = [to_seconds(message.header.stamp) - EPOCH for message in received[topic]]
        np.testing.assert_allclose(stamps, np.arange(2 * rate) / rate, atol=1e-5)


def test_sound_without_a_header_keeps_its_channels(received):
    samples = np.concatenate([np.array(message.samples).reshape(-1, 2) for message in received['audio/frames']])
    assert len(samples) == 60 * BLOCK
    np.testing.assert_allclose(samples[:-5, 0], samples[5:, 1], atol=1e-6)    # left hears it first
