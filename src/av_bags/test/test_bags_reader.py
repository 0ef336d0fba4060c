import sqlite3
import struct
import tempfile
from unittest import mock

import bag_messages as make
import numpy as np
import pytest
from mcap.reader import SeekingReader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from av_bags import Bag, BagError, BagWriter
from av_bags.cli.repair_bag import main as repair_bag

MILLISECOND = 10**6


def foreign_bag(path, storage=StoragePlugin.MCAP, count=200, compression=None):
    """A bag of rosbags alone: two topics, taking turns."""
    with make_foreign(path, storage, compression) as writer:
        topics = [writer.add_connection(f'/{name}/odometry', make.ODOMETRY, typestore=make.TYPES) for name in 'ab']
        for k in range(count):
            writer.write(topics[k % 2], k * MILLISECOND, make.cdr(make.odometry(0.001 * k, x=float(k))))
    return path


def make_foreign(path, storage, compression=None):
    writer = Writer(path, version=9, storage_plugin=storage)
    if compression:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    return writer


def positions(bag, **selection):
    return [bag.decode(topic, data).pose.pose.position.x for topic, _, data in bag.messages(**selection)]


def write_in_chunks(path, compression):
    """1000 poses at x = 0, 1, 2 ... m, in chunks of 50."""
    with mock.patch('av_bags.writer.COMPRESSION', CompressionType[compression.upper()]), BagWriter(path) as writer:
        writer.add_topic('/odometry', make.ODOMETRY)
        for k in range(1000):
            writer.write('/odometry', k, make.cdr(make.odometry(0.001 * k, x=float(k))))
            if k % 50 == 49:
                writer.flush()


@pytest.mark.parametrize('storage', list(StoragePlugin))
@pytest.mark.parametrize('compression', [None, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_reads_bags_of_others(tmp_path, storage, compression):
    with Bag(foreign_bag(tmp_path / 'bag', storage, compression=compression)) as bag:
        assert {topic.name: (topic.kind, topic.count) for topic in bag.topics.values()} == {
            '/a/odometry': (make.ODOMETRY, 100), '/b/odometry': (make.ODOMETRY, 100)}
        assert (bag.start_ns, bag.end_ns) == (0, 199 * MILLISECOND)
        assert positions(bag) == list(range(200))
        assert not bag.problems


@pytest.mark.parametrize('storage', list(StoragePlugin))
def test_reads_bare_files_and_folders_without_metadata(tmp_path, storage):
    folder = foreign_bag(tmp_path / 'bag', storage)
    (folder / 'metadata.yaml').unlink()
    for path in (folder, *folder.iterdir()):
        with Bag(path) as bag:
            assert positions(bag) == list(range(200))


def test_selects_topics_and_times(tmp_path):
    with Bag(foreign_bag(tmp_path / 'bag')) as bag:
        selected = positions(bag, topics=['/b/odometry'], start_ns=50 * MILLISECOND, stop_ns=60 * MILLISECOND)
    assert selected == [51, 53, 55, 57, 59]


def test_reads_messages_of_types_that_only_the_bag_defines(tmp_path):
    writer = McapWriter(str(tmp_path / 'bag.mcap'), compression=CompressionType.NONE)
    writer.start('ros2')
    schema = writer.register_schema('far_msgs/msg/Heat', 'ros2msg', b'float64 kelvin\nfar_msgs/Where where\n' + b'=' * 80
                                    + b'\nMSG: far_msgs/Where\nuint32 room\n')
    channel = writer.register_channel('/heat', 'cdr', schema)
    writer.add_message(channel, 5, b'\x00\x01\x00\x00' + np.float64(300.5).tobytes() + np.uint32(7).tobytes(), 5)
    writer.finish()
    with Bag(tmp_path / 'bag.mcap') as bag:
        topic, _, data = next(bag.messages())
        message = bag.decode(topic, data)
    assert (message.kelvin, message.where.room) == (300.5, 7)


def test_uses_installed_definitions_where_a_bag_has_none(tmp_path):
    folder = foreign_bag(tmp_path / 'bag', StoragePlugin.SQLITE3)
    with sqlite3.connect(folder / 'bag.db3') as database:
        database.execute('DELETE FROM message_definitions')
    with Bag(folder) as bag:
        assert positions(bag) == list(range(200))


def test_a_type_defined_nowhere_is_named(tmp_path):
    with make_foreign(tmp_path / 'bag', StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection('/odd', 'odd_msgs/msg/Odd', msgdef='int8 x', rihs01='RIHS01_0')
        writer.write(topic, 0, b'\x00\x01\x00\x00\x07')
    with sqlite3.connect(tmp_path / 'bag' / 'bag.db3') as database:
        database.execute('DELETE FROM message_definitions')
    with Bag(tmp_path / 'bag') as bag, pytest.raises(BagError, match='/odd cannot be read, odd_msgs/msg/Odd is defined'):
        bag.decode('/odd', b'\x00\x01\x00\x00\x07')


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
@pytest.mark.parametrize('share', [0.3, 0.6, 0.999])
def test_a_truncated_mcap_is_read_as_far_as_it_goes(tmp_path, compression, share):
    whole, cut = tmp_path / 'whole.mcap', tmp_path / 'cut.mcap'
    write_in_chunks(whole, compression)
    content = whole.read_bytes()
    cut.write_bytes(content[:int(share * len(content))])
    with Bag(cut) as bag:
        read = positions(bag)
        assert any('cut.mcap ends after byte' in problem for problem in bag.problems) or share > 0.9
    assert read == list(range(len(read)))
    assert len(read) >= 1000 * share - 300 * (compression != 'none') - 51


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
@pytest.mark.parametrize('number', [0, 10, 19])
def test_a_broken_chunk_costs_only_itself(tmp_path, compression, number):
    """Also the first one, which defines the topic."""
    path = tmp_path / 'bag.mcap'
    write_in_chunks(path, compression)
    content = bytearray(path.read_bytes())
    with path.open('rb') as file:
        chunk = sorted(SeekingReader(file).get_summary().chunk_indexes, key=lambda index: index.chunk_start_offset)[number]
    place = chunk.chunk_start_offset + chunk.chunk_length // 2
    content[place:place + 40] = b'?' * 40
    path.write_bytes(content)
    with Bag(path) as bag:
        assert positions(bag) == [x for x in range(1000) if x // 50 != number]
        assert len(bag.problems) == 1


def test_a_damaged_bag_is_copied_once_however_often_it_is_read(tmp_path, monkeypatch):
    path, copies = tmp_path / 'bag.mcap', tmp_path / 'copies'
    write_in_chunks(path, 'lz4')
    content = bytearray(path.read_bytes())
    content[len(content) // 3:len(content) // 3 + 40] = b'?' * 40
    path.write_bytes(content)
    copies.mkdir()
    monkeypatch.setattr(tempfile, 'tempdir', str(copies))
    with Bag(path) as bag:
        first = positions(bag)
        assert 0 < len(first) < 1000 and all(positions(bag) == first for _ in range(3))
        assert len(list(copies.iterdir())) == 1
    assert not list(copies.iterdir())


def test_a_length_beyond_measure_ends_the_reading(tmp_path):
    path = tmp_path / 'bag.mcap'
    write_in_chunks(path, 'none')
    with path.open('rb') as file:
        chunk = sorted(SeekingReader(file).get_summary().chunk_indexes, key=lambda index: index.chunk_start_offset)[1]
    content = bytearray(path.read_bytes()[:-20])
    struct.pack_into('<Q', content, chunk.chunk_start_offset + 9 + 3 * 8 + 2 * 4, 2**63)    # of the content of a chunk
    path.write_bytes(content)
    with Bag(path) as bag:
        assert positions(bag) == list(range(50)) and len(bag.problems) == 1


@pytest.mark.parametrize('share', np.linspace(0.05, 0.75, 6))
def test_a_broken_index_costs_nothing(tmp_path, share):
    """It may even tell of clocks that were set."""
    path = tmp_path / 'bag.mcap'
    write_in_chunks(path, 'lz4')
    content = bytearray(path.read_bytes())
    with path.open('rb') as file:
        chunks = SeekingReader(file).get_summary().chunk_indexes
    index = chunks[round(share * len(chunks))]
    place = index.chunk_start_offset + index.chunk_length + 100
    content[place:place + 40] = b'?' * 40
    path.write_bytes(content)
    with Bag(path) as bag:
        assert positions(bag) == list(range(1000))


@pytest.mark.parametrize('damaged', [b'no zstd', 'a text'])
def test_a_broken_message_costs_only_itself(tmp_path, damaged):
    path = foreign_bag(tmp_path / 'bag', StoragePlugin.SQLITE3, 20, CompressionMode.MESSAGE)
    with sqlite3.connect(path / 'bag.db3') as database:
        database.execute('UPDATE messages SET data = ? WHERE id = 5', (damaged,))
    with Bag(tmp_path / 'bag') as bag:
        assert positions(bag) == [*range(4), *range(5, 20)]
        assert [problem.partition(': messages are left out')[0] for problem in bag.problems] == ['/a/odometry']


@pytest.mark.parametrize(('name', 'content', 'complaint'), [
    ('empty.mcap', b'', 'is empty: 0 bytes'),
    ('empty.db3', b'', 'is empty: 0 bytes'),
    ('text.mcap', b'this is no bag at all, but text', 'neither mcap nor sqlite3'),
    ('text.txt', b'this is no bag at all, but text', 'neither mcap nor sqlite3'),
    ('swapped.db3', b'\x89MCAP0\r\n' + bytes(100), 'its content is mcap'),
    ('start.mcap', b'\x89MCAP0\r\n', 'the bag holds no messages'),
    ('cut.db3', b'SQLite format 3\x00' + bytes(200), 'cannot be read'),
    ('old.bag', b'#ROSBAG V2.0\n' + bytes(100), 'a bag of ROS 1; convert it with: rosbags-convert'),
])
def test_what_is_no_bag_is_said_so(tmp_path, name, content, complaint):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BagError, match=complaint) as error:
        Bag(tmp_path / name)
    assert name in str(error.value)


def test_a_missing_bag_and_a_folder_without_one_are_said_so(tmp_path):
    with pytest.raises(BagError, match='no such bag'):
        Bag(tmp_path / 'nowhere')
    with pytest.raises(BagError, match=r'a folder without metadata.yaml, .mcap or .db3'):
        Bag(tmp_path)


def test_a_bag_without_messages_is_refused(tmp_path):
    with BagWriter(tmp_path / 'bag.mcap') as writer:
        writer.add_topic('/odometry', make.ODOMETRY)
    with pytest.raises(BagError, match='holds no messages'):
        Bag(tmp_path / 'bag.mcap')


def test_a_truncated_database_gives_an_error_or_a_part(tmp_path):
    folder = foreign_bag(tmp_path / 'bag', StoragePlugin.SQLITE3, count=2000)
    database = folder / 'bag.db3'
    content = database.read_bytes()
    database.write_bytes(content[:len(content) // 2])
    try:
        with Bag(folder) as bag:
            assert len(positions(bag)) < 2000
            assert bag.problems
    except BagError as error:
        assert 'bag cannot be read' in str(error)


@pytest.mark.parametrize('name', ['mended', '\udcff'])
def test_a_damaged_bag_can_be_made_sound_again(tmp_path, capsys, name):
    """Also one whose name is not UTF-8."""
    whole, cut, mended = (tmp_path / f'{name}.mcap' for name in ('whole', 'cut', name))
    write_in_chunks(whole, 'none')
    cut.write_bytes(whole.read_bytes()[:whole.stat().st_size // 2])
    assert repair_bag([str(cut), '--out', str(mended)]) == 0
    captured = capsys.readouterr()
    with AnyReader([mended]) as reader:
        values = [reader.deserialize(data, make.ODOMETRY).pose.pose.position.x for _, _, data in reader.messages()]
    assert values == list(range(len(values)))
    assert f'{len(values)} messages to {tmp_path}/{name.replace(chr(0xdcff), "?")}.mcap' in captured.out
    assert 'cut.mcap ends after byte' in captured.err
    assert repair_bag([str(tmp_path / 'nowhere'), '--out', str(tmp_path / 'x.mcap')]) == 1


def test_a_database_becomes_an_mcap_with_the_definitions_of_its_own(tmp_path):
    with make_foreign(tmp_path / 'bag', StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection('/heat', 'far_msgs/msg/Heat', msgdef='float64 kelvin\n', rihs01='RIHS01_0')
        writer.write(topic, 5, b'\x00\x01\x00\x00' + np.float64(300.5).tobytes())
    assert repair_bag([str(tmp_path / 'bag'), '--out', str(tmp_path / 'bag.mcap')]) == 0
    with AnyReader([tmp_path / 'bag.mcap']) as reader:
        ((connection, time_ns, data),) = reader.messages()
        assert (time_ns, reader.deserialize(data, connection.msgtype).kelvin) == (5, 300.5)


@pytest.mark.parametrize('storage', list(StoragePlugin))
@pytest.mark.parametrize('told', [True, False])
def test_topics_stay_latched(tmp_path, storage, told):
    """As those of a robot's description; where a bag does not say, static transforms are."""
    profile = Qos(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, *[QosTime(0, 0)] * 2,
                  QosLiveliness.AUTOMATIC, QosTime(0, 0), False)
    name = '/robot_description' if told else '/tf_static'
    with make_foreign(tmp_path / 'bag', storage) as writer:
        topic = writer.add_connection(name, 'std_msgs/msg/String', typestore=make.TYPES,
                                      offered_qos_profiles=[profile] if told else ())
        writer.write(topic, 1, make.cdr(make.make('std_msgs/msg/String', '<robot/>')))
    assert repair_bag([str(tmp_path / 'bag'), '--out', str(tmp_path / 'mended.mcap')]) == 0
    with AnyReader([tmp_path / 'mended.mcap']) as reader:
        assert reader.connections[0].ext.offered_qos_profiles[0].durability == QosDurability.TRANSIENT_LOCAL
