import gc
import resource
import signal
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path
from unittest import mock

import bag_messages as make
import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType
from rosbags.highlevel import AnyReader

from av_bags import Bag, BagError, BagWriter, UnknownTypeError, definition
from av_bags.background_writer import BackgroundWriter
from av_bags.writer import LATCHED

SECOND = 10**9


def write_odometry(path, count=500):
    messages = [(k * SECOND // 100, make.cdr(make.odometry(0.01 * k, x=float(k)))) for k in range(count)]
    with BagWriter(path) as bag:
        bag.add_topic('/odometry', make.ODOMETRY)
        for time_ns, data in messages:
            bag.write('/odometry', time_ns, data)
    return messages


@pytest.mark.parametrize('name', ['bag.mcap', 'folder'])
def test_rosbags_reads_every_message(tmp_path, name):
    written = write_odometry(tmp_path / name)
    with AnyReader([tmp_path / name]) as reader:
        read = [(time_ns, data) for _, time_ns, data in reader.messages()]
        values = [reader.deserialize(data, make.ODOMETRY).pose.pose.position.x for _, data in read]
    assert [(time_ns, bytes(data)) for time_ns, data in read] == written
    assert values == [float(k) for k in range(len(written))]


def test_mcap_reads_every_message_with_its_definition(tmp_path):
    written = write_odometry(tmp_path / 'bag.mcap')
    with (tmp_path / 'bag.mcap').open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        rows = list(reader.iter_messages())
    assert [(message.log_time, message.data) for _, _, message in rows] == written
    schema, channel, _ = rows[0]
    assert (schema.name, schema.encoding, channel.message_encoding) == (make.ODOMETRY, 'ros2msg', 'cdr')
    text = schema.data.decode()
    assert 'geometry_msgs/PoseWithCovariance pose' in text
    assert 'MSG: geometry_msgs/Quaternion' in text


def test_many_messages_of_several_topics_fill_several_chunks(tmp_path):
    data = make.cdr(make.odometry(0.0))
    with BagWriter(tmp_path / 'bag.mcap') as bag:
        for name in 'abc':
            bag.add_topic(f'/{name}/odometry', make.ODOMETRY)
        written = [(f'/{"abc"[(k // 7) % 3]}/odometry', k, data[:30 + k % 5]) for k in range(20_000)]
        for message in written:
            bag.write(*message)
        assert sum(bag.counts.values()) == len(written)
    with (tmp_path / 'bag.mcap').open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        rows = [(channel.topic, message) for _, channel, message in reader.iter_messages()]
        assert len(reader.get_summary().chunk_indexes) > 1
    assert [(topic, row.log_time, row.data) for topic, row in rows] == written
    for name in 'abc':
        sequence = [row.sequence for topic, row in rows if topic == f'/{name}/odometry']
        assert sequence == list(range(len(sequence)))


def test_the_rigs_own_messages_carry_their_definition():
    text = definition('av_interfaces/msg/Bearing')
    assert 'float32 azimuth_world_rate' in text
    assert 'STATE_COASTING=3' in text.replace(' = ', '=')


def test_a_type_of_a_missing_package_is_named():
    with pytest.raises(UnknownTypeError, match="package 'no_such_msgs' is not installed"):
        definition('no_such_msgs/msg/Thing')
    with pytest.raises(UnknownTypeError, match=r'NoSuch\.msg does not exist'):
        definition('av_interfaces/msg/NoSuch')


def test_metadata_describes_the_folder_as_rosbag2_does(tmp_path):
    write_odometry(tmp_path / 'folder', count=101)
    text = (tmp_path / 'folder' / 'metadata.yaml').read_text()
    content = yaml.safe_load(text)['rosbag2_bagfile_information']
    assert content['relative_file_paths'] == ['folder_0.mcap']
    assert content['storage_identifier'] == 'mcap'
    assert content['message_count'] == 101
    assert content['duration'] == {'nanoseconds': SECOND}
    topic = content['topics_with_message_count'][0]
    assert topic['message_count'] == 101
    profile = yaml.safe_load(topic['topic_metadata']['offered_qos_profiles'])[0]
    assert (profile['reliability'], profile['durability']) == (1, 2)
    assert '&id' not in text


def test_latched_topics_stay_latched(tmp_path):
    with BagWriter(tmp_path / 'bag.mcap') as bag:
        bag.add_topic('/tf_static', 'tf2_msgs/msg/TFMessage', LATCHED)
        bag.write('/tf_static', 0, b'\x00\x01\x00\x00\x00\x00\x00\x00')
    with AnyReader([tmp_path / 'bag.mcap']) as reader:
        qos = reader.connections[0].ext.offered_qos_profiles[0]
    assert (qos.reliability.name, qos.durability.name) == ('RELIABLE', 'TRANSIENT_LOCAL')


def test_equal_messages_make_equal_files(tmp_path):
    for name in ('a.mcap', 'b.mcap'):
        write_odometry(tmp_path / name)
    assert (tmp_path / 'a.mcap').read_bytes() == (tmp_path / 'b.mcap').read_bytes()


def test_folders_are_made_and_existing_paths_refused(tmp_path):
    path = tmp_path / 'some' / 'where' / 'bag.mcap'
    write_odometry(path, count=3)
    before = path.read_bytes()
    with pytest.raises(BagError, match=r'bag\.mcap exists already; choose another path'):
        BagWriter(path)
    assert path.read_bytes() == before


def test_a_path_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / 'file').write_text('no folder')
    with pytest.raises(BagError, match=r'file/bag\.mcap cannot be created: .*File exists: .*/file'):
        BagWriter(tmp_path / 'file' / 'bag.mcap')


def alone(case, folder):
    """Run a case in a process of its own: its limit holds for every file, also for one into which these tests are logged."""
    code = 'import pathlib, sys, test_bags_writer as t; getattr(t, sys.argv[1])(pathlib.Path(sys.argv[2]))'
    done = subprocess.run([sys.executable, '-c', code, case.__name__, str(folder)], cwd=Path(__file__).parent, timeout=120,
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def small_disk(size):
    """Files cannot grow beyond a size; None lifts the limit."""
    most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    resource.setrlimit(resource.RLIMIT_FSIZE, (most if size is None else size, most))


def test_a_full_disk_loses_nothing_once_there_is_room(tmp_path):
    alone(a_full_disk_with_room_later, tmp_path)


def test_a_disk_that_stays_full_drops_counts_and_leaves_a_readable_bag(tmp_path):
    alone(a_disk_that_stays_full, tmp_path)


@mock.patch('av_bags.writer.COMPRESSION', CompressionType.NONE)
def a_full_disk_with_room_later(tmp_path):
    recording = BackgroundWriter(tmp_path / 'bag.mcap')
    recording.add_topic('/odometry', make.ODOMETRY)
    data = make.cdr(make.odometry(0.0))
    for k in range(100):
        recording.put('/odometry', k, data)
    wait_for(lambda: recording.bag.counts['/odometry'] == 100)
    small_disk(recording.bag.file.stat().st_size + 1000)
    for k in range(100, 200):
        recording.put('/odometry', k, data)
    wait_for(lambda: 'bag.mcap cannot be written: File too large' in recording.problem)
    small_disk(None)
    wait_for(lambda: not recording.problem)
    recording.close()
    with Bag(tmp_path / 'bag.mcap') as bag:
        assert [time_ns for _, time_ns, _ in bag.messages()] == list(range(200))
        assert not bag.problems
    assert recording.dropped == 0


def test_no_message_that_cannot_be_encoded_ends_the_writer(tmp_path):
    def encode(data):
        if data == b'bad':
            raise RuntimeError('not an image')
        return data

    recording = BackgroundWriter(tmp_path / 'bag.mcap')
    recording.add_topic('/image', 'std_msgs/msg/String', encode=encode)
    for data in (b'bad', bytes(8), b'bad', bytes(8)):
        recording.put('/image', 1, data)
    recording.close()
    assert (recording.dropped, recording.unencoded) == (0, 2) and recording.bag.counts == {'/image': 2}
    assert recording.encoding_problem == '/image: not an image'


def test_what_is_written_while_a_message_is_queued_leaves_the_queue(tmp_path):
    class Data(bytes):
        asked = 0

        def __len__(self):
            self.asked += 1
            if self.asked == 2:    # as it is added to what waits
                wait_for(lambda: recording.bag.counts['/text'] == 1)
            return super().__len__()

    recording = BackgroundWriter(tmp_path / 'bag.mcap', queue_bytes=2000)
    recording.add_topic('/text', 'std_msgs/msg/String')
    for data in (bytes(900), Data(8), bytes(1500)):
        recording.put('/text', 1, data)
    recording.close()
    assert recording.dropped == 0 and recording.bag.counts == {'/text': 3}


@mock.patch('av_bags.writer.COMPRESSION', CompressionType.NONE)
def a_disk_that_stays_full(tmp_path):
    recording = BackgroundWriter(tmp_path / 'bag.mcap', queue_bytes=20_000)
    recording.add_topic('/odometry', make.ODOMETRY)
    data = make.cdr(make.odometry(0.0))
    recording.put('/odometry', 0, data)
    wait_for(lambda: recording.bag.counts['/odometry'] == 1)
    wait_for(lambda: recording.bag.file.stat().st_size > 2000)
    small_disk(recording.bag.file.stat().st_size + 1000)
    for k in range(1, 400):
        recording.put('/odometry', k, data)
        time.sleep(0.001)
    assert 0 < recording.dropped < 400
    with pytest.raises(OSError, match='File too large'):
        recording.close()
    small_disk(None)
    with Bag(tmp_path / 'bag.mcap') as bag:
        assert [time_ns for _, time_ns, _ in bag.messages()] == [0]
        assert 'ends after byte' in bag.problems[0]


def wait_for(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, 'the condition was not met in time'
        time.sleep(0.02)


RECORD_UNTIL_KILLED = '''
import sys, time
import bag_messages as make
from av_bags.background_writer import BackgroundWriter
recording = BackgroundWriter(sys.argv[1])
recording.add_topic('/odometry', make.ODOMETRY)
while True:
    now = time.time_ns()
    recording.put('/odometry', now, make.cdr(make.odometry(1e-9 * now)))
    print(now, flush=True)
    time.sleep(0.005)
'''


@pytest.mark.parametrize('name', ['bag.mcap', 'folder'])
def test_a_killed_recording_is_read_up_to_its_last_second(tmp_path, name):
    program = [sys.executable, '-c', RECORD_UNTIL_KILLED, str(tmp_path / name)]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parent) as process:
        put = [int(process.stdout.readline()) for _ in range(400)]
        process.send_signal(signal.SIGKILL)
        put += [int(line) for line in process.stdout.read().split()]
    with Bag(tmp_path / name) as bag:
        read = [time_ns for _, time_ns, _ in bag.messages()]
    assert read == put[:len(read)]
    assert put[-1] - read[-1] < SECOND


def test_memory_does_not_grow_with_the_length_of_the_bag(tmp_path):
    def record(bag, chunks):
        for _ in range(chunks):
            for topic in topics:
                bag.write(topic, 250_000_000 * sum(bag.counts.values()), data)
            bag.flush()
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    topics, data = [f'/topic_{k}' for k in range(12)], make.cdr(make.odometry(0.0))
    tracemalloc.start()
    try:
        with BagWriter(tmp_path / 'bag.mcap') as bag:
            for topic in topics:
                bag.add_topic(topic, make.ODOMETRY)
            settled = record(bag, 400)
            grown = record(bag, 3600) - settled    # a quarter of an hour
    finally:
        tracemalloc.stop()
    assert grown < 100_000
    with (tmp_path / 'bag.mcap').open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        indexes = reader.get_summary().chunk_indexes
        assert len(indexes) == 4000
        assert all(len(index.message_index_offsets) == 12 for index in indexes)
        assert sum(1 for _ in reader.iter_messages(['/topic_7'])) == 4000
    assert [file.name for file in tmp_path.iterdir()] == ['bag.mcap']
