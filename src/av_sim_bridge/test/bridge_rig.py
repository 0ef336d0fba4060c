"""A bridge node under test, with a listener to all that it publishes."""

import time
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image, Imu
from vision_msgs.msg import Detection2DArray

from av_common.qos import IMAGE, RESULT, STREAM
from av_interfaces.msg import AudioFrame, PointingCommand
from av_sim_bridge.nodes.bridge_node import BridgeNode

PATIENCE = 120.0    # s that a loaded machine may take for anything; nothing is concluded from how long it took
RIG = Path(__file__).resolve().parents[3] / 'config' / 'rig.yaml'
TOPICS = {'audio/frames': (AudioFrame, STREAM), 'camera/image_raw': (Image, IMAGE),
          'camera/camera_info': (CameraInfo, RESULT), 'odometry': (Odometry, RESULT), 'truth/rig': (Odometry, RESULT),
          'truth/target': (Odometry, RESULT), 'truth/target_3': (Odometry, RESULT), 'imu': (Imu, STREAM),
          'detections': (Detection2DArray, RESULT), 'camera/depth/image_raw': (Image, IMAGE),
          '/diagnostics': (DiagnosticArray, RESULT)}


class BridgeRig:
    """A bridge node with an offset of its ports, and a listener; `received` holds the messages of each topic."""

    def __init__(self, offset):
        settings = {'port_offset': offset, 'rig_file': RIG, 'oracle_detections': True, 'targets': 2}
        arguments = [text for name, value in settings.items() for text in ('-p', f'{name}:={value}')]
        rclpy.init(args=['--ros-args', *arguments])
        self.node, self.listener = BridgeNode(), rclpy.create_node('listener')
        self.received = {name: [] for name in TOPICS}
        for name, (kind, qos) in TOPICS.items():
            # Deep, so that a machine that stalls loses nothing between node and test.
            deep = QoSProfile(depth=2000, reliability=qos.reliability, durability=qos.durability)
            self.listener.create_subscription(kind, name, self.received[name].append, deep)
        self.commander = self.listener.create_publisher(PointingCommand, 'pointing/command', RESULT)
        self.executor = rclpy.executors.SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.listener)

    def spin(self, seconds, command=None):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
            if command is not None:
                command.header.stamp = self.listener.get_clock().now().to_msg()
                self.commander.publish(command)

    def spin_until(self, condition, what):
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f'{what}: not within {PATIENCE:.0f} s'
            self.executor.spin_once(timeout_sec=0.05)

    def spin_until_connected(self):
        """Until the node is active and every topic that it publishes has found its listener."""
        self.spin_until(lambda: self.node.is_active and all(
            publisher.get_subscription_count() for publisher in self.node._outputs.values()), 'connections')

    def spin_while_coming(self):
        """Until nothing but diagnostics has come for a second."""
        before = -1
        while (now := sum(len(messages) for name, messages in self.received.items() if name != '/diagnostics')) != before:
            before = now
            self.spin(1.0)

    def pairs(self):
        """Depth images that came with a picture of the same stamp and frame."""
        headers = [message.header for message in self.received['camera/image_raw']]
        return [depth for depth in self.received['camera/depth/image_raw'] if depth.header in headers]

    def status(self):
        """The node's diagnostics that were published last; waits for the first ones."""
        self.spin_until(lambda: self.received['/diagnostics'], 'diagnostics')
        return self.received['/diagnostics'][-1].status[0]

    def values(self):
        return {entry.key: entry.value for entry in self.status().values}

    def close(self):
        self.node.close()
        self.node.destroy_node()
        self.listener.destroy_node()
        rclpy.shutdown()
