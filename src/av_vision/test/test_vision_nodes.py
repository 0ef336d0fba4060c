"""The nodes as ROS sees them: headers, ids, stamps, latest-frame policy, errors that heal."""

import math
import re
import time
from array import array
from threading import Event

import cv2
import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy', reason='needs a ROS 2 environment')
pytest.importorskip('av_vision.nodes.camera_node_parameters', reason='needs the workspace to be built')

import yolo_models  # noqa: E402
from builtin_interfaces.msg import Time  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import CameraInfo, CompressedImage, Image  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from vision_msgs.msg import Detection2DArray  # noqa: E402

from av_common.qos import IMAGE, RESULT  # noqa: E402
from av_interfaces.msg import Visibility  # noqa: E402
from av_vision import image_from_message, image_message  # noqa: E402
from av_vision.nodes.camera_node import CameraNode  # noqa: E402
from av_vision.nodes.detector_node import DetectorNode  # noqa: E402

pytestmark = pytest.mark.system


class Rig:
    """Nodes under test in one executor with an observer that collects what they publish."""

    def __init__(self):
        rclpy.init()
        self.executor = SingleThreadedExecutor()
        self.observer = rclpy.create_node('observer')
        self.executor.add_node(self.observer)
        self.nodes = []

    def start(self, node_class, **parameters):
        node = node_class(parameter_overrides=[Parameter(name, value=value) for name, value in parameters.items()])
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def collect(self, kind, topic, qos):
        messages = []
        self.observer.create_subscription(kind, topic, messages.append, qos)
        return messages

    def spin_until(self, condition, limit_s=120.0):
        end = time.monotonic() + limit_s
        while not condition():
            assert time.monotonic() < end, 'the condition was not met in time'
            self.executor.spin_once(timeout_sec=0.05)

    def close(self):
        for node in self.nodes:
            node.close()
            node.destroy_node()
        self.observer.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def rig():
    rig = Rig()
    yield rig
    rig.close()


@pytest.fixture
def model(tmp_path):
    return str(yolo_models.write(tmp_path / 'model.onnx', 'v8', metadata={'names': "['bird', 'drone', 'kite']"}))


def image_at(stamp=5, encoding='bgr8', image=None):
    """An image; a black one has a pixel of its own, as those of a camera that is alive."""
    header = Header(stamp=Time(sec=stamp), frame_id='camera_optical_frame')
    if image is None:
        image = np.zeros((416, 416, 3), np.uint8)
        image[0, 0] = stamp % 200
    return image_message(header, image, encoding)


def stamps_of(messages):
    return {(message.header.stamp.sec, message.header.stamp.nanosec) for message in messages}


def test_a_video_becomes_stamped_images_with_intrinsics(rig, tmp_path):
    path = tmp_path / 'video.avi'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*'MJPG'), 20.0, (64, 48))
    for k in range(30):
        writer.write(np.full((48, 64, 3), 8 * k, np.uint8))
    writer.release()
    images, infos = rig.collect(Image, 'camera/image_raw', IMAGE), rig.collect(CameraInfo, 'camera/camera_info', RESULT)
    rig.start(CameraNode, file=str(path), horizontal_fov_deg=90.0, loop=True)
    rig.spin_until(lambda: len(images) > 10 and stamps_of(images) <= stamps_of(infos))
    assert image_from_message(images[0]).shape == (48, 64, 3)
    assert {message.header.frame_id for message in (*images, *infos)} == {'camera_optical_frame'}
    assert infos[0].k[0] == pytest.approx(32.0)
    stamps = [message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec for message in images]
    levels = [round(image_from_message(message)[0, 0, 0] / 8.0) for message in images]
    frames = 20.0 * np.diff(stamps)  # a slow machine leaves frames out
    assert frames == pytest.approx(np.rint(frames), abs=1e-4)
    assert np.array_equal(np.rint(frames) % 30, np.diff(levels) % 30)


def test_an_image_that_cannot_be_published_is_told_and_the_next_is(rig, tmp_path, monkeypatch):
    cv2.imwrite(str(tmp_path / '0.png'), np.zeros((8, 8), np.uint8))
    refused = [ValueError('of no known type')]

    def failing_at_first(*given):
        if refused:
            raise refused.pop()
        return image_message(*given)

    monkeypatch.setattr('av_vision.nodes.camera_node.image_message', failing_at_first)
    images, status = rig.collect(Image, 'camera/image_raw', IMAGE), rig.collect(DiagnosticArray, '/diagnostics', 10)
    rig.start(CameraNode, file=str(tmp_path), loop=True)
    rig.spin_until(lambda: images and any('image refused: of no known type' in one.message
                                          for message in status for one in message.status))


def test_a_calibration_of_other_images_is_refused_with_both_sizes(rig, tmp_path):
    path, calibration = tmp_path / 'video.avi', tmp_path / 'wide.yaml'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*'MJPG'), 20.0, (64, 48))
    for _ in range(30):
        writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    calibration.write_text('image_width: 1280\nimage_height: 720\n'
                           'camera_matrix: {data: [900, 0, 639.5, 0, 900, 359.5, 0, 0, 1]}\n')
    images, infos = rig.collect(Image, 'camera/image_raw', IMAGE), rig.collect(CameraInfo, 'camera/camera_info', RESULT)
    status = rig.collect(DiagnosticArray, '/diagnostics', 10)
    rig.start(CameraNode, file=str(path), loop=True, calibration_file=str(calibration))
    named = re.compile('wide.yaml: images of 64 x 48 pixels do not fit a camera calibrated for 1280 x 720')
    rig.spin_until(lambda: len(images) > 3 and any(named.search(one.message) and one.level == DiagnosticStatus.ERROR
                                                   for message in status for one in message.status))
    assert not infos


def test_the_camera_infos_of_a_best_effort_publisher_are_read(rig, model):
    """As most drivers send them: a region in the middle of twice the image's width."""
    node = rig.start(DetectorNode, model=model)
    images, infos = (rig.observer.create_publisher(kind, topic, IMAGE)
                     for kind, topic in ((Image, 'camera/image_raw'), (CameraInfo, 'camera/camera_info')))
    status = rig.collect(DiagnosticArray, '/diagnostics', 10)
    rig.spin_until(lambda: node.is_active and images.get_subscription_count() and infos.get_subscription_count())
    k = [500.0, 0.0, 400.0, 0.0, 500.0, 400.0, 0.0, 0.0, 1.0]
    stamps = iter(range(5, 10_000))

    def refused():
        infos.publish(CameraInfo(width=832, height=832, distortion_model='plumb_bob', k=k))
        images.publish(image_at(next(stamps)))
        return any('832 x 832' in one.message for message in status for one in message.status)
    rig.spin_until(refused)


def test_detections_carry_header_names_and_ids(rig, model):
    found = rig.collect(Detection2DArray, 'detections', RESULT)
    seen = rig.collect(Visibility, 'visibility', RESULT)
    node = rig.start(DetectorNode, model=model)
    images = rig.observer.create_publisher(Image, 'camera/image_raw', IMAGE)
    rig.spin_until(lambda: node.is_active and images.get_subscription_count())
    images.publish(image_at(7))
    rig.spin_until(lambda: found and seen)
    array = found[0]
    assert (array.header.stamp.sec, array.header.frame_id) == (7, 'camera_optical_frame')
    drone, = array.detections
    assert drone.header == array.header
    assert drone.id == '1'
    assert drone.results[0].hypothesis.class_id == 'drone'
    assert drone.results[0].hypothesis.score == pytest.approx(0.9, abs=1e-3)
    assert (drone.bbox.center.position.x, drone.bbox.center.position.y) == pytest.approx((128.0, 180.0))
    assert (drone.bbox.size_x, drone.bbox.size_y) == pytest.approx((64.0, 40.0))
    assert seen[0].header == array.header
    assert seen[0].visibility == 0.0  # a black image shows nothing


def test_nothing_seen_is_an_empty_array(rig, tmp_path):
    blind = yolo_models.write(tmp_path / 'blind.onnx', output=np.zeros((1, 5, 3549)), metadata={'names': "['drone']"})
    found = rig.collect(Detection2DArray, 'detections', RESULT)
    node = rig.start(DetectorNode, model=str(blind))
    images = rig.observer.create_publisher(Image, 'camera/image_raw', IMAGE)
    rig.spin_until(lambda: node.is_active and images.get_subscription_count())
    images.publish(image_at(9))
    rig.spin_until(lambda: found)
    assert found[0].header.stamp.sec == 9
    assert not found[0].detections


def test_unusable_images_are_reported_and_the_next_is_used(rig, model):
    found, status = rig.collect(Detection2DArray, 'detections', RESULT), rig.collect(DiagnosticArray, '/diagnostics', 10)
    node = rig.start(DetectorNode, model=model)
    images = rig.observer.create_publisher(Image, 'camera/image_raw', IMAGE)
    rig.spin_until(lambda: node.is_active and images.get_subscription_count())
    wrong = image_at(1)
    wrong.encoding = 'pink9'
    images.publish(wrong)
    rig.spin_until(lambda: any('pink9' in one.message for message in status for one in message.status))
    for k, message in enumerate([image_at(2, 'mono8', np.zeros((416, 416), np.uint8)),
                                 image_at(3, '16UC1', np.zeros((416, 416), np.uint16))]):
        images.publish(message)
        rig.spin_until(lambda: len(found) == k + 1)  # noqa: B023
    assert all(len(message.detections) == 1 for message in found)


def test_a_frozen_camera_is_told(rig, model):
    status = rig.collect(DiagnosticArray, '/diagnostics', 10)
    node = rig.start(DetectorNode, model=model)
    images = rig.observer.create_publisher(Image, 'camera/image_raw', IMAGE)
    rig.spin_until(lambda: node.is_active and images.get_subscription_count())
    found = rig.collect(Detection2DArray, 'detections', RESULT)
    images.publish(image_at(1, image=np.zeros((416, 416, 3), np.uint8)))
    rig.spin_until(lambda: found)
    images.publish(image_at(9, image=np.zeros((416, 416, 3), np.uint8)))
    rig.spin_until(lambda: any('the same image for 8 s' in one.message for message in status for one in message.status))
    assert len(found) == 1


def test_only_the_newest_image_waits(rig, model, monkeypatch):
    found = rig.collect(Detection2DArray, 'detections', RESULT)
    node = rig.start(DetectorNode, model=model)
    images = rig.observer.create_publisher(Image, 'camera/image_raw', IMAGE)
    rig.spin_until(lambda: node.is_active and images.get_subscription_count())
    detector, busy, done = node._stage.detector.detector, Event(), Event()
    candidates = detector.candidates
    monkeypatch.setattr(detector, 'candidates', lambda *given: (busy.set(), done.wait(), candidates(*given))[2])
    images.publish(image_at(1))
    rig.spin_until(busy.is_set)
    sent = iter(range(2, 1000))
    while node._dropped <= 10:
        images.publish(image_at(next(sent)))
        rig.executor.spin_once(timeout_sec=0.02)
    done.set()
    rig.spin_until(lambda: len(found) > 1)
    assert found[0].header.stamp.sec == 1
    assert found[1].header.stamp.sec > 10


def test_compressed_images_and_the_debug_image_on_demand(rig, model):
    found = rig.collect(Detection2DArray, 'detections', RESULT)
    node = rig.start(DetectorNode, model=model, compressed=True)
    images = rig.observer.create_publisher(CompressedImage, 'camera/image_raw/compressed', IMAGE)
    rig.spin_until(lambda: node.is_active and images.get_subscription_count())
    encoded = cv2.imencode('.jpg', np.zeros((416, 416, 3), np.uint8))[1]
    message = CompressedImage(format='jpeg', data=array('B', encoded.tobytes()))
    message.header.stamp.sec = 4
    images.publish(message)
    rig.spin_until(lambda: found)
    drawn = rig.collect(Image, 'detections/image', IMAGE)
    rig.spin_until(lambda: node._debug.get_subscription_count())
    message.header.stamp.sec = 5
    images.publish(message)
    rig.spin_until(lambda: drawn)
    assert drawn[0].header.stamp.sec == 5
    assert image_from_message(drawn[0]).max() > 100


def test_a_missing_model_is_an_error_that_heals(rig, model, tmp_path):
    status = rig.collect(DiagnosticArray, '/diagnostics', 10)
    path = tmp_path / 'later.onnx'
    node = rig.start(DetectorNode, model=str(path))
    rig.spin_until(lambda: any('later.onnx does not exist' in one.message and one.level == b'\x02'
                               for message in status for one in message.status))
    assert not node.is_active
    path.write_bytes(yolo_models.write(tmp_path / 'good.onnx', metadata={'names': "['a', 'drone', 'b']"}).read_bytes())
    rig.spin_until(lambda: node.is_active)


def test_a_missing_device_is_told_and_tried_again(rig):
    status = rig.collect(DiagnosticArray, '/diagnostics', 10)
    node = rig.start(CameraNode, source='device', device='/dev/video77')
    rig.spin_until(lambda: any('/dev/video77 cannot be opened' in one.message for message in status for one in message.status))
    assert node._capture.reconnections >= 1


def test_a_realsense_publishes_colour_depth_and_motion(rig, monkeypatch):
    pytest.importorskip('pyrealsense2', reason='pyrealsense2 is not installed')
    from fake_realsense import DEPTH_MM, FakeRealSense
    from sensor_msgs.msg import Imu

    fake = FakeRealSense()
    monkeypatch.setattr('av_vision.sources.realsense.RealSenseSource._find', lambda self: fake.device)
    images, depths = (rig.collect(Image, topic, IMAGE) for topic in ('camera/image_raw', 'camera/depth/image_raw'))
    infos, motions = rig.collect(CameraInfo, 'camera/camera_info', RESULT), rig.collect(Imu, 'imu/data_raw', IMAGE)
    rig.start(CameraNode, source='device', device='realsense', depth=True, imu=True)
    fake.start()
    rig.spin_until(lambda: len(images) > 3 and len(depths) > 3 and infos and motions)
    fake.stop()
    assert infos[0].k[0] == 605.0
    assert np.median(image_from_message(depths[0])) == DEPTH_MM
    assert motions[0].linear_acceleration.y == pytest.approx(-9.81)
    assert motions[0].orientation_covariance[0] == -1.0
    assert {message.header.stamp.nanosec for message in depths} & {message.header.stamp.nanosec for message in images}


def test_absurd_images_and_cameras_are_counted_and_the_node_goes_on(rig, model):
    """Sizes that the data does not have, encodings that it is not in, bombs, and cameras that cannot be."""
    found = rig.collect(Detection2DArray, 'detections', RESULT)
    node = rig.start(DetectorNode, model=model, camera_height=1.5)
    images = rig.observer.create_publisher(Image, 'camera/image_raw', IMAGE)
    depths = rig.observer.create_publisher(Image, 'camera/depth/image_raw', IMAGE)
    infos = rig.observer.create_publisher(CameraInfo, 'camera/camera_info', RESULT)
    rig.spin_until(lambda: node.is_active and images.get_subscription_count() and infos.get_subscription_count()
                   and depths.get_subscription_count())
    def refused():
        return sum(node.refused.counts.values())
    most = 2**32 - 1
    absurd = [{'height': most}, {'width': most}, {'height': most, 'width': most, 'step': most}, {'step': 1}, {'step': most},
              {'encoding': 'yuv422', 'width': 415}, {'encoding': '32FC1'}, {'encoding': 'x' * 1000}, {'height': 0}]
    absurd_images = []
    for fields in absurd:
        absurd_images.append(image_at())
        for name, value in fields.items():
            setattr(absurd_images[-1], name, value)
    for publisher in (images, depths):
        for message in absurd_images:
            before = refused()
            publisher.publish(message)
            rig.spin_until(lambda before=before: refused() > before)
    for k, width in (([math.inf] * 9, 640), ([1e300] * 9, 640), ([500.0] * 9, most), ([1e-300] * 9, 640)):
        before = refused()
        infos.publish(CameraInfo(width=width, height=480, k=k, distortion_model='plumb_bob', d=[0.0] * 5))
        rig.spin_until(lambda before=before: refused() > before)
    images.publish(image_at(9))
    rig.spin_until(lambda: found)
    assert [message.header.stamp.sec for message in found] == [9]
