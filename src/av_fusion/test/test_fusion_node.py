"""fusion_node in a graph, with what robots publish."""

import math
import time

import pytest
import rclpy
from geometry_msgs.msg import Quaternion, TransformStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from ros_domains import free_domain
from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection2D, Detection2DArray, ObjectHypothesisWithPose

pytest.importorskip('av_fusion.nodes.fusion_node_parameters', reason='needs the workspace to be built')

from av_common.qos import LATCHED, RESULT, STREAM
from av_common.stamps import to_stamp
from av_fusion.nodes.fusion_node import FusionNode
from av_interfaces.msg import Bearing

pytestmark = pytest.mark.system

HEADING, LEFT = math.radians(40.0), 0.2    # of the body in the world, and of the target on the body
UPSIDE_DOWN = Quaternion(x=1.0, w=0.0)    # an IMU below the plate: a half turn about x
OPTICAL = Quaternion(x=-0.5, y=0.5, z=-0.5, w=0.5)    # z forward, x right


def transform(child, rotation):
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.transform.rotation = 'base_link', rotation
    return message


def test_a_bearing_in_the_world_is_right_with_odometry_of_an_imu_that_hangs_upside_down():
    rclpy.init(domain_id=free_domain())
    executor, robot, fusion, bearings = SingleThreadedExecutor(), rclpy.create_node('robot'), FusionNode(), []
    robot.create_subscription(Bearing, 'target/bearing', bearings.append, RESULT)
    frames = robot.create_publisher(TFMessage, 'tf_static', LATCHED)
    frames.publish(TFMessage(transforms=[transform('imu', UPSIDE_DOWN), transform('camera', OPTICAL)]))
    kinds = {'odometry': Odometry, 'camera/camera_info': CameraInfo, 'detections': Detection2DArray}
    out = {name: robot.create_publisher(kind, name, STREAM) for name, kind in kinds.items()}
    for node in (robot, fusion):
        executor.add_node(node)
    box = Detection2D(results=[ObjectHypothesisWithPose()])
    box.results[0].hypothesis.class_id, box.results[0].hypothesis.score = 'drone', 0.9
    box.bbox.center.position.x, box.bbox.center.position.y = 319.5 - 457.0 * math.tan(LEFT), 239.5
    box.bbox.size_x = box.bbox.size_y = 20.0
    end = time.monotonic() + 30.0
    while not any(one.source & Bearing.SOURCE_SIGHT and one.attitude_known for one in bearings) and time.monotonic() < end:
        now = to_stamp(time.time())
        pose = Odometry(child_frame_id='imu')    # the body's yaw, then the half turn about its x axis
        pose.pose.pose.orientation = Quaternion(x=math.cos(0.5 * HEADING), y=math.sin(0.5 * HEADING), w=0.0)
        info = CameraInfo(width=640, height=480, distortion_model='plumb_bob', d=[0.0] * 5,
                          k=[457.0, 0.0, 319.5, 0.0, 457.0, 239.5, 0.0, 0.0, 1.0])
        sent = (('odometry', pose), ('camera/camera_info', info), ('detections', Detection2DArray(detections=[box])))
        for name, message in sent:
            message.header.stamp, message.header.frame_id = now, 'odom' if name == 'odometry' else 'camera'
            out[name].publish(message)
        for _ in range(10):
            executor.spin_once(timeout_sec=0.01)
    seen = [one for one in bearings if one.source & Bearing.SOURCE_SIGHT and one.attitude_known]
    fusion.close()
    for node in (fusion, robot):
        node.destroy_node()
    executor.shutdown()
    rclpy.try_shutdown()
    assert seen
    assert seen[-1].azimuth == pytest.approx(LEFT, abs=0.01)
    assert seen[-1].azimuth_world == pytest.approx(HEADING + LEFT, abs=0.01)
    assert seen[-1].elevation_world == pytest.approx(0.0, abs=0.01)
