import math

import bag_messages as make
import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagFile
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

from av_bags import AudioLayout, Bag, BagError, Feed, deserialiser, find_topics, serialiser
from av_common.track import Track
from av_common.track_messages import bearing_message, state_message
from av_interfaces.msg import DoaArray, PointingCommand, Visibility
from av_vision.messages import image_from_message, image_message


def test_topics_are_found_by_name_namespace_ending_or_not(tmp_path):
    with make.bag(tmp_path / 'bag') as write:
        for topic in ('/a/doa', '/b/doa', '/a/odometry'):
            message = make.odometry(0.0) if 'odometry' in topic else make.doa(0.0, 0.1)
            write(topic, 0.0, message)
    with Bag(tmp_path / 'bag') as bag:
        found = find_topics(bag, ('doa', 'odometry', 'truth/rig'))
        assert found.topics == {'odometry': '/a/odometry'}
        assert 'more than one topic could be doa: /a/doa, /b/doa' in found.missing['doa']
        assert found.missing['truth/rig'] == 'no topic truth/rig (by its type /a/odometry could be it: truth/rig:=/a/odometry)'
        assert find_topics(bag, ('doa',), namespace='b').topics == {'doa': '/b/doa'}
        assert find_topics(bag, ('doa',), {'doa': '/a/doa'}).topics == {'doa': '/a/doa'}


@pytest.mark.parametrize('ending', ['', '/compressed'])
def test_what_is_known_of_a_camera_is_beside_its_images(tmp_path, ending):
    """As image_transport has it: another camera's intrinsics are wrong, whatever its name."""
    with make.bag(tmp_path / 'bag') as write:
        write(f'/zed/left/image_raw{ending}', 0.0, make.image('jpeg' if ending else 'bgr8'))
        for camera in ('camera', 'zed/left'):
            write(f'/{camera}/camera_info', 0.0, make.camera_info(0.0))
    names, images = ('camera/image_raw', 'camera/camera_info'), {'camera/image_raw': f'/zed/left/image_raw{ending}'}
    with Bag(tmp_path / 'bag') as bag:
        assert find_topics(bag, names, images).topics['camera/camera_info'] == '/zed/left/camera_info'
        told = images | {'camera/camera_info': '/camera/camera_info'}
        assert find_topics(bag, names, told).topics['camera/camera_info'] == '/camera/camera_info'


@pytest.fixture
def mixed(tmp_path):
    """A bag of directions as the rig has them, and of images and poses that are to be converted."""
    with make.bag(tmp_path / 'bag') as write:
        write('/doa', make.EPOCH, make.doa(make.EPOCH - 0.25, 0.3))
        write('/camera/image_raw/compressed', make.EPOCH + 0.1, make.image('png'))
        pose = make.odometry(make.EPOCH + 0.2, x=3.0, yaw=0.5).pose.pose
        write('/pose', make.EPOCH + 0.2, make.make('geometry_msgs/msg/PoseStamped', make.header(make.EPOCH + 0.2, 'map'), pose))
        broken = make.image('jpeg')
        broken.data = broken.data[:20]
        write('/camera/image_raw/compressed', make.EPOCH + 0.3, broken)
    with Bag(tmp_path / 'bag') as bag:
        yield bag, {'doa': '/doa', 'camera/image_raw': '/camera/image_raw/compressed', 'odometry': '/pose'}


def test_records_hold_messages_of_the_rigs_types(mixed):
    bag, topics = mixed
    feed = Feed(bag, topics)
    doa, image, odometry = feed
    assert (doa.name, image.name, odometry.name) == ('doa', 'camera/image_raw', 'odometry')
    assert np.subtract([doa.arrival, image.arrival, odometry.arrival], make.EPOCH) == pytest.approx([0.0, 0.1, 0.2], abs=1e-6)
    assert isinstance(doa.message, DoaArray) and isinstance(image.message, Image) and isinstance(odometry.message, Odometry)
    assert doa.message.hypotheses[0].azimuth == pytest.approx(0.3)
    assert doa.data == next(data for topic, _, data in bag.messages(['/doa']))
    assert not image.data and not odometry.data
    assert image_from_message(image.message).shape == (48, 64, 3)
    assert odometry.message.pose.pose.position.x == 3.0
    assert [problem.partition(': expected')[0] for problem in feed.problems] == [
        '/camera/image_raw/compressed: image of 20 bytes cannot be decoded']


def test_a_description_of_audio_with_other_fields_is_none(tmp_path):
    """Another package has the same name."""
    writer = Writer(str(tmp_path / 'bag.mcap'), compression=CompressionType.NONE)
    writer.start('ros2')
    described = b'int32 format\nint16 channels\nint32 rate\nint32 chunk\n'
    for time, (topic, kind, text) in enumerate((('/info', 'AudioInfo', described),
                                                ('/audio/frames', 'AudioData', b'uint8[] data\n'))):
        schema = writer.register_schema(f'audio_common_msgs/msg/{kind}', 'ros2msg', text)
        writer.add_message(writer.register_channel(topic, 'cdr', schema), time, b'\0\1\0\0' + bytes(16), time)
    writer.finish()
    with Bag(tmp_path / 'bag.mcap') as bag, pytest.raises(BagError, match='neither rate nor channels; give audio_rate'):
        Feed(bag, {'audio/frames': '/audio/frames'})


@pytest.mark.parametrize('name', ['/camera/image_raw', '/robot/camera/image_raw'])
@pytest.mark.parametrize('raw', [0, 1])
def test_images_that_were_recorded_raw_and_compressed_are_taken_once(tmp_path, name, raw):
    """The raw ones where there are any: a topic without messages is as if it were missing."""
    small, large = make.image('png'), make.image('bgr8')
    with BagFile(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {topic: writer.add_connection(topic, message.__msgtype__, typestore=make.TYPES)
                  for topic, message in ((name, large), (f'{name}/compressed', small))}
        for topic, message in ((f'{name}/compressed', small), *[(name, large)] * raw):
            writer.write(topics[topic], round(make.EPOCH * 1e9), make.cdr(message))
    with Bag(tmp_path / 'bag') as bag:
        found = find_topics(bag, ('camera/image_raw',))
        assert found.topics == {'camera/image_raw': name if raw else f'{name}/compressed'}


@pytest.mark.parametrize('lost', [(0.0, 0.0, 0.0, 0.0), (math.nan,) * 4])
def test_a_pose_without_attitude_costs_no_rate_of_the_next_one(tmp_path, lost):
    """The rig turns at 0.5 rad/s."""
    with make.bag(tmp_path / 'bag') as write:
        for step in range(8):
            time = make.EPOCH + 0.1 * step
            pose = make.odometry(time, yaw=0.05 * step).pose.pose
            if step == 3:
                pose.orientation = make.make('geometry_msgs/msg/Quaternion', *lost)
            write('/pose', time, make.make('geometry_msgs/msg/PoseStamped', make.header(time, 'map'), pose))
    with Bag(tmp_path / 'bag') as bag:
        rates = [record.message.twist.twist.angular.z for record in Feed(bag, {'odometry': '/pose'})]
    assert [rate for step, rate in enumerate(rates) if step not in (0, 3)] == pytest.approx([0.5] * 6, abs=1e-4)


@pytest.mark.parametrize(('data', 'sample_format', 'samples'), [
    (b'\x00\x40\x00\xc0', 'S16LE', [0.5, -0.5]), (b'\x00\x00\x00\x40\x00\x00\x00\xc0', 'S32LE', [0.5, -0.5]),
    (b'\x00\x00\x80\x3f\x00\x00\x80\xbf', 'F32LE', [1.0, -1.0])])
def test_full_scale_is_one_and_a_sample_may_come_in_two_parts(tmp_path, data, sample_format, samples):
    """By values written out by hand."""
    with make.bag(tmp_path / 'bag') as write:
        for time, part in ((make.EPOCH, data[:3]), (make.EPOCH + 0.001, data[3:])):
            write('/audio/frames', time, make.make('audio_common_msgs/msg/AudioData', np.frombuffer(part, np.uint8)))
    with Bag(tmp_path / 'bag') as bag:
        record, = Feed(bag, {'audio/frames': '/audio/frames'}, AudioLayout(48_000, 2, sample_format))
    np.testing.assert_allclose(record.message.samples, samples)
    with pytest.raises(BagError, match="'MP3', expected one of S16LE"):
        AudioLayout(48_000, 1, 'MP3')


@pytest.mark.parametrize(('array', 'scale'), [('int16_data', 2**15), ('int32_data', 2**31), ('float32_data', 1.0)])
def test_sound_that_describes_itself_needs_no_layout(tmp_path, array, scale):
    """AudioStamped, whose package shares its name with the one of AudioDataStamped: 16 kHz in two channels."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    arrays = {'float32_data': np.float32, 'int32_data': np.int32, 'int16_data': np.int16}
    for kind, text in (('AudioInfo', 'int32 format\nint16 channels\nint32 rate\nint32 chunk'),
                       ('AudioData', '\n'.join(f'{name.partition("_")[0]}[] {name}' for name in arrays)),
                       ('Audio', 'audio_common_msgs/AudioData audio_data\naudio_common_msgs/AudioInfo info'),
                       ('AudioStamped', 'std_msgs/Header header\naudio_common_msgs/Audio audio')):
        types.register(get_types_from_msg(text, f'audio_common_msgs/msg/{kind}'))
    of, sound = types.types, np.array([0.5, -0.25] * 1600)
    data = [np.array(scale * sound if name == array else [], kind) for name, kind in arrays.items()]
    with BagFile(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection('/audio', 'audio_common_msgs/msg/AudioStamped', typestore=types)
        for step in range(3):
            time = make.EPOCH + 0.1 * step
            header = of['std_msgs/msg/Header'](of['builtin_interfaces/msg/Time'](*divmod(round(time * 1e9), 10**9)), 'ears')
            audio = of['audio_common_msgs/msg/Audio'](
                of['audio_common_msgs/msg/AudioData'](*data), of['audio_common_msgs/msg/AudioInfo'](8, 2, 16_000, 1600))
            message = of['audio_common_msgs/msg/AudioStamped'](header, audio)
            writer.write(topic, round(time * 1e9), bytes(types.serialize_cdr(message, message.__msgtype__)))
    with Bag(tmp_path / 'bag') as bag:
        feed = Feed(bag, find_topics(bag, ('audio/frames',), {'audio/frames': '/audio'}).topics)
        frames = [record.message for record in feed]
    assert not feed.lost and [frame.first_sample for frame in frames] == [0, 1600, 3200]
    assert {(frame.sample_rate, frame.channels, frame.header.frame_id) for frame in frames} == {(16_000, 2, 'ears')}
    np.testing.assert_allclose(frames[1].samples, sound, atol=1e-4)


def test_reasons_that_differ_in_each_message_are_not_all_kept(tmp_path):
    with make.bag(tmp_path / 'bag') as write:
        for number in range(200):
            broken = make.image('jpeg')
            broken.data = broken.data[:20 + number]
            write('/camera/image_raw/compressed', make.EPOCH + 0.1 * number, broken)
    with Bag(tmp_path / 'bag') as bag:
        feed = Feed(bag, {'camera/image_raw': '/camera/image_raw/compressed'})
        assert not list(feed) and sum(feed.problems.values()) == 200
        assert len(feed.lost) < 30 and '180 messages of /camera/image_raw/compressed, for further reasons' in feed.lost


def test_without_decoding_only_what_is_converted_becomes_a_message(mixed):
    doa, image, odometry = Feed(*mixed, decode=False)
    assert doa.message is None and doa.data
    assert isinstance(image.message, Image) and isinstance(odometry.message, Odometry)


def test_messages_are_serialised_as_by_rclpy():
    vision = deserialize_message(make.cdr(make.detections(make.EPOCH, 0.1)), Detection2DArray)
    doa = deserialize_message(make.cdr(make.doa(make.EPOCH, 0.3)), DoaArray)
    track = Track(make.EPOCH)
    odometry = Odometry(child_frame_id='base_link')
    for message in (vision, doa, bearing_message(track, 'base_link'), state_message(track, ['doa', 'odometry'], 'base_link'),
                    PointingCommand(reason='why'), Visibility(visibility=0.5), odometry):
        name = f'{type(message).__module__.split(".")[0]}/msg/{type(message).__name__}'
        assert serialiser(name)(message).rstrip(b'\0') == bytes(serialize_message(message)).rstrip(b'\0')


def test_messages_are_deserialised_as_by_rclpy_and_images_are_not_copied():
    data = make.cdr(make.detections(make.EPOCH, 0.1))
    assert deserialiser('vision_msgs/msg/Detection2DArray')(data).detections[0].bbox.size_x == deserialize_message(
        data, Detection2DArray).detections[0].bbox.size_x
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    data = bytes(serialize_message(image_message(Header(frame_id='camera'), pixels)))
    message = deserialiser('sensor_msgs/msg/Image')(data)
    assert message.header.frame_id == 'camera' and np.array_equal(image_from_message(message), pixels)
    assert np.shares_memory(message.data, np.frombuffer(data, np.uint8))


@pytest.mark.parametrize('kind', [DoaArray, Image, Odometry, Detection2DArray])
def test_malformed_data_are_refused_by_a_value_error_only(kind):
    name = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
    messages = {DoaArray: make.doa(make.EPOCH, 0.3), Detection2DArray: make.detections(make.EPOCH, 0.1)}
    good = make.cdr(messages[kind]) if kind in messages else bytes(serialize_message(kind()))
    deserialise, random = deserialiser(name), np.random.default_rng(1)
    refused = 0
    for _ in range(500):
        data = bytearray(good[:random.integers(len(good) + 1)] if random.random() < 0.3 else good)
        for place in random.integers(0, max(len(data), 1), random.integers(0, 6)):
            data[place:place + 1] = bytes([random.integers(256)])
        try:
            deserialise(bytes(data))
        except ValueError:
            refused += 1
    assert refused > 50


def test_topics_of_a_second_camera_are_not_those_of_the_first(tmp_path):
    with make.bag(tmp_path / 'bag') as write:
        write('/rig/second_camera/detections', make.EPOCH, make.detections(make.EPOCH))
    with Bag(tmp_path / 'bag') as bag:
        found = find_topics(bag, ('detections', 'second_camera/detections'))
        assert found.topics == {'second_camera/detections': '/rig/second_camera/detections'}
        assert found.missing == {'detections': 'no topic detections'}


def test_with_a_namespace_the_topics_of_other_rigs_are_not_taken(tmp_path):
    frames = make.static_frames(make.EPOCH)
    with make.bag(tmp_path / 'two') as write:
        for topic in ('/left/tf_static', '/right/tf_static'):
            write(topic, make.EPOCH, frames)
        write('/right/doa', make.EPOCH, make.doa(make.EPOCH, 0.1))
        write('/odometry', make.EPOCH, make.odometry(make.EPOCH))
        write('/left/robot/detections', make.EPOCH, make.detections(make.EPOCH))
    wanted = ('tf_static', 'doa', 'odometry', 'detections')
    with Bag(tmp_path / 'two') as bag:
        found = find_topics(bag, wanted, namespace='left')
        assert found.topics == {'tf_static': '/left/tf_static', 'odometry': '/odometry', 'detections': '/left/robot/detections'}
        assert 'doa:=/right/doa' in found.missing['doa']
        assert find_topics(bag, wanted, {'/tf_static': '/right/tf_static'}, 'left').topics['tf_static'] == '/right/tf_static'
        assert 'tf_static' in find_topics(bag, wanted).missing
    with make.bag(tmp_path / 'older') as write:    # of a release whose frames were on /tf_static
        write('/tf_static', make.EPOCH, frames)
        write('/left/doa', make.EPOCH, make.doa(make.EPOCH, 0.1))
    with Bag(tmp_path / 'older') as bag:
        assert find_topics(bag, ('tf_static',), namespace='left').topics == {'tf_static': '/tf_static'}
