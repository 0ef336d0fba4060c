import time

import numpy as np
import pytest
import rclpy
from diagnostic_updater import DiagnosticStatusWrapper
from geometry_msgs.msg import TransformStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import Image
from std_msgs.msg import Header, String
from tf2_msgs.msg import TFMessage

from av_bags import KINDS, Bag
from av_bags.nodes.recorder_node import RecorderNode, compress, numbered
from av_common.launched import RESTARTS
from av_common.parameters import node_parameters
from av_common.qos import LATCHED, RESULT, STREAM
from av_interfaces.msg import AudioFrame, Bearing
from av_vision.messages import image_from_message, image_message

pytestmark = pytest.mark.system


class Rig:
    """A recorder and a node that publishes what a rig does, in one process."""

    def __init__(self, **parameters):
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.recorder = RecorderNode(context=self.context, namespace='rig_1', parameter_overrides=overrides)
        self.sender = rclpy.create_node('sender', context=self.context, namespace='rig_1')
        self.executor.add_node(self.recorder)
        self.executor.add_node(self.sender)

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)

    def spin_until(self, condition, seconds=20.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, 'the condition was not met in time'
            self.executor.spin_once(timeout_sec=0.02)

    def publish(self, publisher, messages):
        self.spin_until(lambda: publisher.get_subscription_count())
        for message in messages:
            publisher.publish(message)
            self.spin(0.01)

    def recorded(self):
        return sum(count for topic, count in self.recorder._writer.bag.counts.items() if topic != '/diagnostics')

    def close(self):
        self.recorder.close()
        for node in (self.recorder, self.sender):
            node.destroy_node()
        self.executor.shutdown()
        rclpy.shutdown(context=self.context)


def wait_until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, 'the condition was not met in time'
        time.sleep(0.02)


@pytest.mark.parametrize('data', [b'', b'\0'])
def test_an_image_without_content_is_refused(data):
    """The middleware reads beyond its end, and ends the process."""
    with pytest.raises(ValueError, match='bytes'):
        compress(data)


@pytest.fixture
def rig(tmp_path):
    rigs = []

    def start(**parameters):
        rigs.append(Rig(**{'path': str(tmp_path / 'bag.mcap'), **parameters}))
        return rigs[-1]

    yield start
    for one in rigs:
        if one.context.ok():
            one.close()


def test_each_activation_begins_a_bag_of_its_own(rig, tmp_path):
    rig = rig()
    rig.spin_until(lambda: rig.recorder.is_active)
    for _ in range(2):
        rig.recorder.trigger_deactivate()
        rig.recorder.trigger_activate()
        assert rig.recorder.is_active
    assert sorted(file.name for file in tmp_path.glob('*.mcap')) == ['bag.mcap', 'bag_1.mcap', 'bag_2.mcap']


def test_records_streams_results_and_latched_topics_that_appear_late_or_early(rig, tmp_path):
    rig = rig()
    latched = rig.sender.create_publisher(TFMessage, 'tf_static', LATCHED)
    latched.publish(TFMessage(transforms=[TransformStamped(child_frame_id='microphones')]))  # before anyone listens
    audio = rig.sender.create_publisher(AudioFrame, 'audio/frames', STREAM)
    bearing = rig.sender.create_publisher(Bearing, 'target/bearing', RESULT)
    samples = np.linspace(-1.0, 1.0, 200, dtype=np.float32)
    rig.publish(audio, [AudioFrame(header=Header(frame_id='microphones'), sample_rate=48000, channels=2,
                                   first_sample=100 * k, samples=samples.tolist()) for k in range(20)])
    rig.publish(bearing, [Bearing(azimuth=0.01 * k, state=1) for k in range(20)])
    rig.spin_until(lambda: rig.recorded() == 41)
    rig.close()
    with AnyReader([tmp_path / 'bag.mcap']) as reader:
        read = {connection.topic: [] for connection in reader.connections}
        for connection, _, data in reader.messages():
            read[connection.topic].append(reader.deserialize(data, connection.msgtype))
        durability = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in reader.connections}
    assert [frame.first_sample for frame in read['/rig_1/audio/frames']] == [100 * k for k in range(20)]
    np.testing.assert_array_equal(read['/rig_1/audio/frames'][7].samples, samples)
    np.testing.assert_allclose([b.azimuth for b in read['/rig_1/target/bearing']], 0.01 * np.arange(20), atol=1e-6)
    assert read['/rig_1/tf_static'][0].transforms[0].child_frame_id == 'microphones'
    assert durability['/rig_1/tf_static'] == 'TRANSIENT_LOCAL'
    assert durability['/rig_1/target/bearing'] == 'VOLATILE'


def test_the_rigs_type_is_recorded_where_a_topic_has_several_and_others_are_reported(rig, tmp_path):
    rig, context = rig(), rclpy.Context()
    rclpy.init(context=context)    # within a process the middleware refuses a second type
    other = rclpy.create_node('other', context=context, namespace='rig_1')
    for name in ('target/bearing', 'marks'):
        other.create_publisher(String, name, RESULT)
    wait_until(lambda: rig.recorder.get_publishers_info_by_topic('/rig_1/target/bearing'))
    bearing = rig.sender.create_publisher(Bearing, 'target/bearing', RESULT)
    rig.publish(bearing, [Bearing()] * 3)
    rig.spin_until(lambda: rig.recorded() == 3)
    status = DiagnosticStatusWrapper()
    rig.recorder.diagnose(status)
    assert '/rig_1/target/bearing is recorded as av_interfaces/msg/Bearing: std_msgs/msg/String is left out' in status.message
    assert '/rig_1/marks' not in status.message    # of any type
    rig.close()
    other.destroy_node()
    rclpy.shutdown(context=context)
    with Bag(tmp_path / 'bag.mcap') as bag:
        assert bag.topics['/rig_1/target/bearing'].count == 3


def test_after_a_disk_that_was_full_at_the_end_another_bag_begins(rig, tmp_path, monkeypatch):
    rig = rig()
    rig.spin_until(lambda: rig.recorder.is_active)
    close = rig.recorder._writer.close

    def full():
        close()
        raise OSError('No space left on device')

    monkeypatch.setattr(rig.recorder._writer, 'close', full)
    rig.recorder.trigger_deactivate()
    rig.recorder.trigger_activate()
    assert rig.recorder.is_active and (tmp_path / 'bag_1.mcap').exists()


@pytest.mark.parametrize(('images', 'topic'), [('raw', '/rig_1/camera/image_raw'),
                                               ('jpeg', '/rig_1/camera/image_raw/compressed'), ('none', None)])
def test_images_are_recorded_raw_or_small_or_not_at_all(rig, tmp_path, images, topic):
    rig = rig(images=images)
    publisher = rig.sender.create_publisher(Image, 'camera/image_raw', STREAM)
    bearing = rig.sender.create_publisher(Bearing, 'target/bearing', RESULT)
    rows, columns = np.mgrid[0:48, 0:64]
    image = np.stack([rows * 4, columns * 3, rows + columns], -1).astype(np.uint8)
    message = image_message(Header(frame_id='camera_optical_frame'), image, 'bgr8')
    if topic:
        rig.publish(publisher, [message] * 3)
    rig.publish(bearing, [Bearing()] * 3)
    rig.spin_until(lambda: rig.recorded() == (6 if topic else 3))
    rig.close()
    with Bag(tmp_path / 'bag.mcap') as bag:
        assert set(bag.topics) - {'/diagnostics'} == {topic, '/rig_1/target/bearing'} - {None}
        if topic:
            _, _, data = next(bag.messages([topic]))
            read = bag.decode(topic, data)
            assert read.header.frame_id == 'camera_optical_frame'
            error = np.abs(image_from_message(read).astype(int) - image)
            assert error.max() <= (0 if images == 'raw' else 12)


def test_an_existing_bag_is_refused_and_said_so(rig, tmp_path):
    (tmp_path / 'bag.mcap').write_text('precious')
    rig = rig()
    rig.spin(0.5)
    assert not rig.recorder.is_active
    assert 'bag.mcap exists already; choose another path or remove it' in rig.recorder._problem
    assert (tmp_path / 'bag.mcap').read_text() == 'precious'


def test_without_a_path_nothing_is_recorded_and_said_so(tmp_path, rig):
    rig = rig(path='')
    rig.spin(0.5)
    assert not rig.recorder.is_active
    assert 'path is empty, expected the bag to write' in rig.recorder._problem


def test_a_restarted_recorder_continues_in_another_bag(rig, tmp_path, monkeypatch):
    """What the process before has recorded stays as it is."""
    (tmp_path / 'bag.mcap').write_text('the first part')
    monkeypatch.setenv(RESTARTS, '2')
    first = rig()
    first.spin_until(lambda: (tmp_path / 'bag_2.mcap').exists())
    assert (tmp_path / 'bag.mcap').read_text() == 'the first part'


@pytest.mark.parametrize(('path', 'number', 'expected'), [
    ('flight.mcap', 0, 'flight.mcap'), ('flight.mcap', 1, 'flight_1.mcap'), ('/data/flights/one', 3, '/data/flights/one_3')])
def test_bags_of_one_launch_are_numbered(path, number, expected):
    assert numbered(path, number) == expected


def test_all_that_can_be_replayed_is_recorded():
    """Of each camera of a rig, too."""
    assert set(KINDS) <= set(node_parameters('av_bags', 'recorder_node').topics)
