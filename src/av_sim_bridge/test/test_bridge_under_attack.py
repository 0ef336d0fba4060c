"""The node as a process of its own, with absurd datagrams among genuine ones: its memory, and what it publishes."""

import os
import socket
import struct
import subprocess
import sys
import threading
import time
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('av_sim_bridge.nodes.bridge_node_parameters', reason='needs the built workspace')

from bridge_rig import PATIENCE, RIG  # noqa: E402
from fake_rflysim import image_datagrams  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402
from udp_ports import free_offset  # noqa: E402

from av_common.qos import IMAGE  # noqa: E402
from av_sim_bridge.vehicle import VehicleState, to_truth  # noqa: E402
from av_sim_bridge.wire.image import EncodedImage, encode_image  # noqa: E402
from av_sim_bridge.wire.ports import Ports  # noqa: E402
from av_sim_bridge.wire.truth import encode_truth  # noqa: E402

pytestmark = pytest.mark.system
MOST_GROWTH = 20.0    # MiB
GENUINE = np.random.default_rng(1).integers(0, 255, (480, 640, 3), np.uint8)    # noise: as large as an image can get


def bomb(width, height):
    """A PNG of a size that a few kilobytes decompress to."""
    def chunk(name, content):
        return struct.pack('>I', len(content)) + name + content + struct.pack('>I', zlib.crc32(name + content))
    packer = zlib.compressobj(9)
    data = b''.join(packer.compress(bytes(1 + 3 * width)) for _ in range(height)) + packer.flush()
    return (b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', struct.pack('>2I5B', width, height, 8, 2, 0, 0, 0)) + chunk(b'IDAT', data)
            + chunk(b'IEND', b''))


@pytest.fixture
def bridge():
    """The process, its ports, and a node in its domain."""
    offset = free_offset()
    ports, settings = Ports().shifted(offset), {'port_offset': offset, 'rig_file': RIG}
    arguments = [text for name, value in settings.items() for text in ('-p', f'{name}:={value}')]
    process = subprocess.Popen([sys.executable, '-m', 'av_sim_bridge.nodes.bridge_node', '--ros-args', *arguments],
                               env=dict(os.environ))
    rclpy.init()
    node = rclpy.create_node('watcher')
    yield process, ports, node
    node.destroy_node()
    rclpy.shutdown()
    process.terminate()
    process.wait(30.0)


def resident(process):
    """Resident memory in MiB."""
    lines = Path(f'/proc/{process.pid}/status').read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith('VmRSS'))


def attack(ports, send):
    """Images, states and sound as no simulator sends them; `send(port, datagrams)`."""
    huge, largest = bomb(12_000, 12_000), cv2.imencode('.png', GENUINE)[1].tobytes()
    jpeg = cv2.imencode('.jpg', GENUINE)[1].tobytes()
    scans = jpeg[:-2] + 200 * jpeg[jpeg.index(b'\xff\xda'):-2][:5000] + jpeg[-2:]
    rng = np.random.default_rng(2)
    for number in range(60):
        instant = 1.0 + 0.01 * number
        for port in (ports.image, ports.depth):
            for data in (huge, largest + bytes(3_000_000), scans):
                send(port, image_datagrams(data, instant, number))
            send(port, [fragment for count in range(40) for fragment in    # images that are never complete
                        image_datagrams(bytes(120_000), instant + 1e-4 * count, 1000 + count)[:1]])
        for port in (ports.rig_truth, ports.target_truth):
            send(port, [encode_truth(to_truth(VehicleState(instant, np.array([1e300, 0.0, 0.0])), 1))])
        for port in vars(ports).values():
            send(port, [rng.bytes(size) for size in (0, 1, 24, 40, 168, 60_000)])


def test_nothing_that_is_sent_takes_memory_or_stops_the_images(bridge):
    process, ports, node = bridge
    images, attacking = [], True
    node.create_subscription(Image, 'camera/image_raw', images.append, IMAGE)
    encoded, began = cv2.imencode('.jpg', GENUINE)[1].tobytes(), time.monotonic()

    def feed():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as source:
            while attacking:
                for datagram in encode_image(EncodedImage(time.monotonic() - began, encoded)):
                    source.sendto(datagram, ('127.0.0.1', ports.image))
                time.sleep(0.1)

    def spin_until(condition):
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end and process.poll() is None
            rclpy.spin_once(node, timeout_sec=0.05)

    feeder = threading.Thread(target=feed)
    feeder.start()
    try:
        spin_until(lambda: len(images) > 20)
        before, highest = resident(process), 0.0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as source:
            def send(port, datagrams):
                nonlocal highest
                for datagram in datagrams:
                    source.sendto(datagram, ('127.0.0.1', port))
                    rclpy.spin_once(node, timeout_sec=0.0)
                highest = max(highest, resident(process))
            attack(ports, send)
        count = len(images)
        spin_until(lambda: len(images) > count + 10)
        highest = max(highest, resident(process))
    finally:
        attacking = False
        feeder.join()
    print(f'resident memory {before:.1f} MiB before, {highest:.1f} MiB at most')
    assert process.poll() is None and highest - before < MOST_GROWTH
    assert {(image.width, image.height) for image in images} == {(640, 480)}
