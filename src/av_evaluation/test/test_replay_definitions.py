import bag_messages as make
import numpy as np
import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from av_bags.definitions import BagError
from av_bags.reader import Bag
from av_bags.writer import BagWriter
from av_evaluation.replay.replay import Replay


def test_a_bag_with_definitions_of_its_own_is_read_by_them(tmp_path):
    """Detections as another version of their package has them: with one more field in each."""
    kind, part = 'vision_msgs/msg/Detection2DArray', 'vision_msgs/msg/Detection2D'
    other = get_typestore(Stores.EMPTY)
    text = make.TYPES.generate_msgdef(part, ros_version=2)[0].split('=' * 80)[0]
    other.register({**make.TYPES.fielddefs, **get_types_from_msg(text.replace('string id', 'string id\nint64[3] more'), part)})
    with Bag(make.flight(tmp_path / 'bag', duration=4.0)) as bag, Writer(tmp_path / 'other', version=9) as writer:
        connections = {topic.name: writer.add_connection(topic.name, topic.kind, typestore=other)
                       for topic in bag.topics.values()}
        for topic, time_ns, data in bag.messages():
            if topic == '/detections':
                message = bag.decode(topic, data)
                message.detections = [other.types[part](d.header, d.results, d.bbox, d.id, np.zeros(3, np.int64))
                                      for d in message.detections]
                data = other.serialize_cdr(message, kind)
            writer.write(connections[topic], time_ns, bytes(data))
        expected = Replay(bag).run()
    with Bag(tmp_path / 'other') as bag:
        log = Replay(bag).run()
    np.testing.assert_array_equal(log.sight['azimuth'], expected.sight['azimuth'])
    assert np.isfinite(log.sight['azimuth']).any()


def test_a_bag_of_older_messages_of_the_rig_is_refused_by_name(tmp_path):
    """Directions as they were before they carried their cosine."""
    kind, part = 'av_interfaces/msg/DoaArray', 'av_interfaces/msg/Doa'
    older = get_typestore(Stores.EMPTY)
    text = make.TYPES.generate_msgdef(part, ros_version=2)[0].split('=' * 80)[0]
    lines = [line for line in text.splitlines() if 'cosine' not in line]
    older.register({**make.TYPES.fielddefs, **get_types_from_msg('\n'.join(lines), part)})
    with Bag(make.flight(tmp_path / 'bag', duration=1.0)) as bag, Writer(tmp_path / 'older', version=9) as writer:
        connections = {topic.name: writer.add_connection(topic.name, topic.kind, typestore=older)
                       for topic in bag.topics.values()}
        for topic, time_ns, data in bag.messages():
            writer.write(connections[topic], time_ns, bytes(data))
    with Bag(tmp_path / 'older') as bag, pytest.raises(BagError, match=(
            r'/doa was recorded with another definition of av_interfaces/msg/DoaArray than the installed one, '
            r'which differs in Doa\.cosine, Doa\.cosine_variance; use the release that recorded it')):
        assert bag.topics['/doa'].kind == kind
        Replay(bag)


@pytest.mark.parametrize('release', ['foxy', 'galactic'])
def test_detections_before_humble_are_those_of_today(tmp_path, release):
    """Of vision_msgs 2 and 3: classes were of the results, or centres geometry_msgs/Pose2D."""
    array, part, stated, box = (f'vision_msgs/msg/{name}' for name in (
        'Detection2DArray', 'Detection2D', 'ObjectHypothesisWithPose', 'BoundingBox2D'))
    before = get_typestore(Stores.ROS2_FOXY)
    before.register({name: fields for name, fields in make.TYPES.fielddefs.items() if name.endswith('/ObjectHypothesis')})
    for name, text in {
            stated: 'string id\nfloat64 score\n' if release == 'foxy' else 'vision_msgs/ObjectHypothesis hypothesis\n',
            box: 'geometry_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n',
            part: f'std_msgs/Header header\n{stated}[] results\n{box} bbox\nbool is_tracking\n',
            array: f'std_msgs/Header header\n{part}[] detections\n'}.items():
        if name == stated:
            text += 'geometry_msgs/PoseWithCovariance pose\n'
        before.register(get_types_from_msg(text.replace('/msg/', '/'), name))
    types, out = before.types, tmp_path / 'out.mcap'

    def of_that_time(one):
        result, at = one.results[0], one.bbox.center.position
        told = (result.hypothesis.class_id, result.hypothesis.score) if release == 'foxy' else (result.hypothesis,)
        middle = types['geometry_msgs/msg/Pose2D'](at.x, at.y, 0.0)
        return types[part](one.header, [types[stated](*told, result.pose)], types[box](
            middle, one.bbox.size_x, one.bbox.size_y), False)

    with Bag(make.flight(tmp_path / 'bag', duration=4.0)) as bag, Writer(tmp_path / 'old', version=8) as writer:
        connections = {topic.name: writer.add_connection(
            topic.name, topic.kind, typestore=before if topic.kind == array else make.TYPES) for topic in bag.topics.values()}
        for topic, time_ns, data in bag.messages():
            if topic == '/detections':
                message = bag.decode(topic, data)
                data = before.serialize_cdr(types[array](message.header, list(map(of_that_time, message.detections))), array)
            writer.write(connections[topic], time_ns, bytes(data))
        expected = Replay(bag).run()
    with Bag(tmp_path / 'old') as bag, BagWriter(out) as writer:
        replay = Replay(bag)
        log = replay.run(writer)
        assert not replay.lost
    np.testing.assert_array_equal(log.sight['azimuth'], expected.sight['azimuth'])
    assert np.isfinite(log.sight['azimuth']).any()
    with Bag(out) as bag:
        np.testing.assert_array_equal(Replay(bag).run().sight['azimuth'], expected.sight['azimuth'])
