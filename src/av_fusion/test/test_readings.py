import bag_messages as make
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from vision_msgs.msg import Detection2DArray

from av_bags.reader import Bag
from av_evaluation.replay.replay import Replay
from av_fusion.measurement.readings import CLARITY, HEARD, SEEN
from av_interfaces.msg import DoaArray, Visibility

NAMES = ['', 'a', 'ab', 'abc', 'abcd', 'abcde', 'microphones']


def heard(frame, method='ml', hypotheses=2):
    message = make.doa(1234.25, 0.3, frame=frame)
    rng = np.random.default_rng(hypotheses)
    message.method = method
    message.hypotheses = [make.make('av_interfaces/msg/Doa', make.vector(*rng.normal(size=3)), *rng.normal(size=5), k,
                                    bool(k % 2)) for k in range(hypotheses)]
    return message


def seen(frame, name='drone', boxes=2, results=2):
    message = make.detections(1234.25, 0.1, frame=frame)
    found = message.detections[0]
    result = make.make('vision_msgs/msg/ObjectHypothesisWithPose', make.make('vision_msgs/msg/ObjectHypothesis', name, 0.25),
                       found.results[0].pose)
    message.detections = [make.make('vision_msgs/msg/Detection2D', make.header(7.0, name), [*found.results, result][:results],
                                    found.bbox, name * k) for k in range(boxes)]
    return message


def clarity(frame):
    return make.make('av_interfaces/msg/Visibility', make.header(1234.25, frame), 0.75, 120.0)


MESSAGES = [(HEARD, heard(frame, *rest)) for frame in NAMES for rest in (('', 0), ('a', 1), ('gcc', 2), ('music', 3))]
MESSAGES += [(SEEN, seen(frame, *rest)) for frame in NAMES for rest in (('a', 0), ('b', 1, 0), ('bird', 2, 1), ('plane', 3, 2))]
MESSAGES += [(CLARITY, clarity(frame)) for frame in NAMES]


@pytest.mark.parametrize('little', [True, False])
def test_messages_are_read_as_rosbags_reads_them(little):
    for reading, message in MESSAGES:
        data = bytes(make.TYPES.serialize_cdr(message, message.__msgtype__, little_endian=little))
        expected = reading.of(make.TYPES.deserialize_cdr(data, message.__msgtype__))
        assert reading.read(data) == expected
        assert reading.read(data + bytes(3)) == expected  # what some middleware pads to
        assert expected.time == 1234.25


@pytest.mark.parametrize('little', [True, False])
def test_bytes_that_end_early_or_late_are_refused(little):
    for reading, message in MESSAGES[::11]:
        data = bytes(make.TYPES.serialize_cdr(message, message.__msgtype__, little_endian=little))
        cut = [data[:length] for length in range(0, len(data), 3)]
        for broken in (*cut, data + bytes(4), b'\0\3' + data[2:], b'\1' + data[1:]):
            with pytest.raises(ValueError, match=f'^{len(broken)} bytes are no '):
                reading.read(broken)


@pytest.mark.parametrize(('reading', 'kind', 'message'), [
    (HEARD, DoaArray, heard('microphones')), (SEEN, Detection2DArray, seen('camera')), (CLARITY, Visibility, clarity('eye'))])
def test_messages_of_the_middleware_are_read_as_it_reads_them(reading, kind, message):
    live = deserialize_message(make.cdr(message), kind)
    assert reading.read(serialize_message(live)) == reading.of(live) == reading.read(make.cdr(message))


def test_a_bag_with_definitions_of_its_own_is_read_by_them(tmp_path):
    """Detections as another version of their package has them: with one more field in each."""
    kind, part = 'vision_msgs/msg/Detection2DArray', 'vision_msgs/msg/Detection2D'
    other = get_typestore(Stores.EMPTY)
    text = make.TYPES.generate_msgdef(part, ros_version=2)[0].split('=' * 80)[0]
    other.register({**make.TYPES.fielddefs, **get_types_from_msg(text.replace('string id', 'string id\nint64[3] more'), part)})
    with Bag(make.flight(tmp_path / 'bag', duration=4.0)) as bag, Writer(tmp_path / 'other', version=9) as writer:
        assert bag.is_as_installed('/detections')
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
        assert not bag.is_as_installed('/detections')
        assert bag.is_as_installed('/doa')
        log = Replay(bag).run()
    np.testing.assert_array_equal(log.sight['azimuth'], expected.sight['azimuth'])
    assert np.isfinite(log.sight['azimuth']).any()
