"""Bags as they are in the field: in several files, with definitions that are none, and of clocks that were set."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import bag_messages as make
import numpy as np
import pytest
import yaml
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import zstd

from av_bags import Bag, Feed, definition

SECOND = 10**9
SEPARATOR = '=' * 80 + '\n'    # of the parts of a definition, by rosbag2
START = round(make.EPOCH * SECOND)
FIELD_CASES = Path(__file__).resolve().parents[4] / 'shared' / 'data' / 'field_cases'


def recorded(seconds=8.0, begin=make.EPOCH):
    """Topics, times (ns) and messages of a rig in order of time; stamps are those of their times."""
    rows = []
    for k in range(round(20 * seconds)):
        time = begin + 0.05 * k
        rows.append(('/odometry', round(time * SECOND), make.odometry(time, x=float(k))))
        if k % 2:
            rows.append(('/doa', round(time * SECOND) + 7_000_000, make.doa(time, 0.01 * k)))
    return rows


def write(path, rows, storage=StoragePlugin.MCAP, compressed=False):
    """A bag of rosbags alone in the order of the rows, whose messages may be compressed one by one; returns its one file."""
    writer, topics = Writer(path, version=9, storage_plugin=storage), {}
    if compressed:
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        for topic, time_ns, message in rows:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, message.__msgtype__, typestore=make.TYPES)
            writer.write(topics[topic], time_ns, make.cdr(message))
    return next(file for file in path.iterdir() if file.suffix in ('.mcap', '.db3'))


def folder_of(path, parts, storage=StoragePlugin.MCAP, listed=None):
    """A folder of several files named bag_0 on, with metadata of those `listed` (indices; None: without metadata)."""
    path.mkdir()
    files = []
    for number, rows in enumerate(parts):
        file = write(path / f'part{number}', rows, storage)
        files.append(path / f'bag_{number}{file.suffix}')
        shutil.move(file, files[-1])
        metadata = yaml.safe_load((path / f'part{number}' / 'metadata.yaml').read_text())
        shutil.rmtree(path / f'part{number}')
    if listed is not None:
        metadata['rosbag2_bagfile_information']['relative_file_paths'] = [files[k].name for k in listed]
        (path / 'metadata.yaml').write_text(yaml.safe_dump(metadata))
    return path


def keys(rows):
    return [(topic, time_ns, make.cdr(message)) for topic, time_ns, message in rows]


@pytest.mark.parametrize('described', [True, False])
@pytest.mark.parametrize('storage', list(StoragePlugin))
@pytest.mark.parametrize('kind', ['overlapping', 'by topic', 'at random'])
def test_files_of_a_folder_are_merged_by_time(tmp_path, kind, storage, described):
    rows, rng = recorded(), np.random.default_rng(2)
    of = {'overlapping': lambda k, row: int(k > 100 + 60 * (row[0] == '/doa')),
          'by topic': lambda k, row: int(row[0] == '/doa'), 'at random': lambda k, row: int(rng.integers(3))}[kind]
    parts = {}
    for k, row in enumerate(rows):
        parts.setdefault(of(k, row), []).append(row)
    path = folder_of(tmp_path / 'bag', [parts[k] for k in sorted(parts)], storage, sorted(parts) if described else None)
    with Bag(path) as bag:
        assert list(bag.messages()) == keys(rows)
        assert len(bag.segments) == 1 and not bag.problems and not bag.notes


def test_metadata_decide_what_belongs_to_a_bag(tmp_path):
    rows = recorded()
    path = folder_of(tmp_path / 'bag', [rows[:150], rows[150:], recorded(3.0, make.EPOCH + 1.01)], listed=[0, 1])
    shutil.copy(path / 'bag_0.mcap', path / 'bag_0_repaired.mcap')
    (path / '._bag_0.mcap').write_bytes(b'\0\5\26\7 resource fork')
    with Bag(path) as bag:
        assert list(bag.messages()) == keys(rows)
        assert bag.notes == [f'{name} is left out: metadata.yaml does not list it'
                             for name in ('bag_0_repaired.mcap', 'bag_2.mcap')]
        assert not bag.problems


def test_what_metadata_list_in_vain_is_named(tmp_path):
    rows = recorded()
    path = folder_of(tmp_path / 'bag', [rows[:150], rows[150:]], listed=[0, 1])
    (path / 'bag_1.mcap').unlink()
    with Bag(path) as bag:
        assert list(bag.messages()) == keys(rows[:150])
        assert bag.problems == ['bag_1.mcap is missing, which metadata.yaml lists']
    (path / 'bag_0.mcap').rename(path / 'flight.mcap')
    with Bag(path) as bag:
        assert list(bag.messages()) == keys(rows[:150])
        assert 'no file of metadata.yaml is there (bag_0.mcap, bag_1.mcap)' in bag.notes[0]
    (path / 'metadata.yaml').write_text('')
    with Bag(path) as bag:
        assert len(list(bag.messages())) == 150 and 'metadata.yaml cannot be read' in bag.notes[0]


@pytest.mark.parametrize('storage', list(StoragePlugin))
@pytest.mark.parametrize('content', [b'', b'\0' * 5000, None], ids=['empty', 'zeros', 'cut off'])
@pytest.mark.parametrize('bad', [0, 1])
def test_one_bad_file_costs_only_its_own_messages(tmp_path, storage, content, bad):
    rows = recorded()
    parts = [rows[:150], rows[150:]]
    path = folder_of(tmp_path / 'bag', parts, storage, listed=[0, 1])
    file = sorted(path.glob('bag_*'))[bad]
    file.write_bytes(file.read_bytes()[:20] if content is None else content)
    with Bag(path) as bag:
        assert list(bag.messages()) == keys(parts[1 - bad])
        assert [problem for problem in bag.problems if file.name in problem]


@pytest.mark.parametrize('bad', [0, 1])
@pytest.mark.parametrize('content', [b'', b'no zstd', zstd.compress(b'no bag'), None], ids=['empty', 'text', 'none', 'nowhere'])
def test_one_bad_compressed_file_costs_only_its_own_messages(tmp_path, content, bad):
    rows = recorded()
    parts = [rows[:150], rows[150:]]
    path = folder_of(tmp_path / 'bag', parts)
    for number, file in enumerate(sorted(path.iterdir())):
        packed = file.with_name(f'{file.name}.zstd')
        if number != bad:
            packed.write_bytes(zstd.compress(file.read_bytes()))
        elif content is None:
            packed.symlink_to(tmp_path / 'nowhere')
        else:
            packed.write_bytes(content)
        file.unlink()
    with Bag(path) as bag:
        assert list(bag.messages()) == keys(parts[1 - bad])
        assert [problem for problem in bag.problems if f'bag_{bad}.mcap.zstd' in problem]


@pytest.mark.parametrize('storage', list(StoragePlugin))
def test_compressed_messages_of_a_killed_recorder_are_read(tmp_path, storage):
    """Metadata, which would tell, are written last."""
    rows = recorded(2.0)
    write(tmp_path / 'bag', rows, storage, compressed=True)
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    with Bag(tmp_path / 'bag') as bag:
        assert list(bag.messages()) == keys(rows) and not bag.problems


def test_a_database_of_a_killed_recorder_is_read_with_its_log(tmp_path):
    """As the preset `resilient` of rosbag2 leaves it; also where the file is in a folder that cannot be written."""
    rows, killed = recorded(), tmp_path / 'killed'
    file = write(tmp_path / 'bag', rows, StoragePlugin.SQLITE3)
    database = sqlite3.connect(file)
    kept = database.execute('SELECT * FROM messages ORDER BY id').fetchall()
    places = ','.join('?' * len(kept[0]))
    database.execute('DELETE FROM messages WHERE id > 100')
    database.commit()
    database.execute('PRAGMA journal_mode = WAL')
    database.execute('PRAGMA wal_autocheckpoint = 0')
    database.executemany(f'INSERT INTO messages VALUES ({places})', [row for row in kept if row[0] > 100])
    database.commit()
    killed.mkdir()
    for each in file.parent.glob('*.db3*'):
        shutil.copy(each, killed / each.name)
    database.close()
    before = {each.name: each.read_bytes() for each in killed.iterdir()}
    killed.chmod(0o500)
    with Bag(killed) as bag:
        assert list(bag.messages()) == keys(rows) and not bag.problems
    killed.chmod(0o700)
    assert {each.name: each.read_bytes() for each in killed.iterdir()} == before, 'what somebody may still write stays'
    (killed / f'{file.name}-wal').write_bytes(b'no log')
    with Bag(killed) as bag:
        assert list(bag.messages()) == keys(rows)[:100]


def test_a_topic_of_two_types_has_that_of_most_messages(tmp_path):
    rows = recorded(4.0)
    others = [('/odometry', time_ns, message) for topic, time_ns, message in rows[:30] if topic == '/doa']
    path = folder_of(tmp_path / 'bag', [rows, others])
    with Bag(path) as bag:
        feed = Feed(bag, {'odometry': '/odometry', 'doa': '/doa'})
        assert len(list(feed)) == len(rows) and not feed.problems
        assert bag.problems == [f'/odometry: {len(others)} messages of av_interfaces/msg/DoaArray are not read, '
                                f'most are {make.ODOMETRY}']


def test_names_in_metadata_may_be_given_twice_and_of_another_system(tmp_path):
    rows = recorded()
    path = folder_of(tmp_path / 'bag', [rows[:150], rows[150:]], listed=[0, 1, 1])
    with Bag(path) as bag:
        assert list(bag.messages()) == keys(rows)
    metadata = path / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace('bag_1', 'C:\\flights\\bag_1').replace('bag_0', '/home/me/bag_0'))
    with Bag(path) as bag:
        assert list(bag.messages()) == keys(rows) and not bag.notes and not bag.problems


def test_a_repaired_copy_does_not_double_a_folder_without_metadata(tmp_path):
    rows = recorded()
    path = folder_of(tmp_path / 'bag', [rows, rows[20:300]])
    with Bag(path) as bag:
        assert list(bag.messages()) == keys(rows)
        assert '220 messages are in two files' in bag.notes[-1]


def full(kind):
    return definition(kind)


SCHEMAS = {
    'empty': lambda kind: b'',
    'its name': lambda kind: kind.encode(),
    'a blank line': lambda kind: b'\n\n',
    'without its parts': lambda kind: full(kind).split('=' * 80)[0].encode(),
    'without some parts': lambda kind: ('=' * 80).join(full(kind).split('=' * 80)[:2]).encode(),
    'of Windows': lambda kind: full(kind).replace('\n', '\r\n').encode(),
    'with a mark': lambda kind: b'\xef\xbb\xbf' + full(kind).encode(),
    'damaged': lambda kind: b'float64[ x y\n' + full(kind).encode(),
    'a comment': lambda kind: b'# no definition\n',
    'with a comment in Latin-1': lambda kind: b'# 20 \xb0C, 3 \xb5s\n' + full(kind).encode(),
    'of UTF-16': lambda kind: full(kind).encode('utf-16'),
}


def write_with_schemas(path, rows, schema, encoding='ros2msg', others=(), name=str):
    """An mcap file in which the schema of each type is `schema(type)`, its name `name(type)`.

    others: topic, encodings of message and schema, data.
    """
    writer = McapWriter(str(path), compression=CompressionType.LZ4)
    writer.start('ros2')
    channels = {}
    for topic, messages, schemas, data in others:
        channel = writer.register_channel(topic, messages, writer.register_schema('Other', schemas, b'{}'))
        writer.add_message(channel, rows[0][1], data, rows[0][1])
    for number, (topic, time_ns, message) in enumerate(rows):
        if topic not in channels:
            kind = message.__msgtype__
            channels[topic] = writer.register_channel(topic, 'cdr', writer.register_schema(name(kind), encoding, schema(kind)))
        writer.add_message(channels[topic], time_ns, make.cdr(message), time_ns, number)
    writer.finish()
    return path


@pytest.mark.parametrize('name', SCHEMAS)
def test_types_without_a_usable_definition_are_read_as_installed(tmp_path, name):
    rows = recorded(2.0)
    with Bag(write_with_schemas(tmp_path / 'bag.mcap', rows, SCHEMAS[name])) as bag:
        feed = Feed(bag, {'odometry': '/odometry', 'doa': '/doa'})
        found = list(feed)
        assert not feed.problems and len(found) == len(rows)
        assert [one.message.pose.pose.position.x for one in found if one.name == 'odometry'] == list(range(40))
        assert found[2].message.hypotheses[0].azimuth == pytest.approx(0.01)


def test_types_in_the_spelling_of_ros1_are_the_same(tmp_path):
    rows = recorded(2.0)
    path = write_with_schemas(tmp_path / 'bag.mcap', rows, lambda kind: full(kind).encode(),
                              name=lambda kind: kind.replace('/msg', ''))
    with Bag(path) as bag:
        assert bag.topics['/odometry'].kind == make.ODOMETRY
        feed = Feed(bag, {'odometry': '/odometry', 'doa': '/doa'})
        assert len(list(feed)) == len(rows) and not feed.problems


def test_a_schema_without_encoding_and_topics_of_others_do_no_harm(tmp_path):
    others = [('/notes', 'json', 'jsonschema', b'{"a": 1}'), ('/scene', 'protobuf', 'protobuf', b'\x08\x01'),
              ('/typeless', 'cdr', '', b'\0\1\0\0')]
    path = write_with_schemas(tmp_path / 'bag.mcap', recorded(1.0), lambda kind: b'', '', others)
    with Bag(path) as bag:
        assert set(bag.topics) == {'/odometry', '/doa'}
        assert len(list(Feed(bag, {'odometry': '/odometry', 'doa': '/doa'}))) == 30
        assert [problem.partition(' are')[0] for problem in sorted(bag.problems)] == [
            "/notes: messages in 'json'", "/scene: messages in 'protobuf'", "/typeless: messages of type 'Other'"]


@pytest.mark.parametrize('part', ['float64 wrong\n', 'float64 a\nfloat64 a\n'])
def test_a_type_that_defines_a_part_in_its_own_way_does_not_change_the_others(tmp_path, part):
    text = f'std_msgs/Header header\n{SEPARATOR}MSG: std_msgs/Header\n{part}'.encode()
    rows = recorded(1.0)
    writer = McapWriter(str(tmp_path / 'bag.mcap'))
    writer.start('ros2')
    for kind, own in (*((f'odd_msgs/msg/Odd{k}', text) for k in range(5)), (make.ODOMETRY, full(make.ODOMETRY).encode())):
        channel = writer.register_channel(f'/{kind}', 'cdr', writer.register_schema(kind, 'ros2msg', own))
        writer.add_message(channel, rows[0][1], make.cdr(rows[0][2]), rows[0][1])
    writer.finish()
    with Bag(tmp_path / 'bag.mcap') as bag:
        feed = Feed(bag, {'truth/rig': f'/{make.ODOMETRY}'})
        assert len(list(feed)) == 1 and not feed.problems


def test_a_definition_that_contradicts_itself_is_none(tmp_path):
    path = write_with_schemas(tmp_path / 'bag.mcap', recorded(1.0), lambda kind: b'float64 a\nfloat64 a\n')
    with Bag(path) as bag:
        feed = Feed(bag, {'truth/rig': '/odometry'})
        assert len(list(feed)) == 20 and not feed.problems


def test_messages_that_cannot_be_read_are_counted(tmp_path):
    """A node of another release sent some, which are too short."""
    rows = recorded(1.0)
    writer = McapWriter(str(tmp_path / 'bag.mcap'))
    writer.start('ros2')
    kind = make.ODOMETRY
    channel = writer.register_channel('/odometry', 'cdr', writer.register_schema(kind, 'ros2msg', b''))
    for k, (topic, time_ns, message) in enumerate(rows):
        if topic == '/odometry':
            writer.add_message(channel, time_ns, make.cdr(message)[:30 if k % 10 == 3 else None], time_ns)
    writer.finish()
    with Bag(tmp_path / 'bag.mcap') as bag:
        feed = Feed(bag, {'odometry': '/odometry'})
        assert len(list(feed)) == 18 and sum(feed.problems.values()) == 2
        assert all(text.startswith('2 messages of /odometry: ') for text in feed.lost)


@pytest.mark.parametrize('decode', [True, False])
def test_messages_without_content_are_counted(tmp_path, decode):
    """The middleware would read beyond their end."""
    path, rows = tmp_path / 'bag.mcap', recorded(1.0)
    writer = McapWriter(str(path))
    writer.start('ros2')
    channel = writer.register_channel('/odometry', 'cdr', writer.register_schema(make.ODOMETRY, 'ros2msg', b''))
    for data in (b'', b'\0\1', make.cdr(rows[0][2])):
        writer.add_message(channel, rows[0][1], data, rows[0][1])
    writer.finish()
    with Bag(path) as bag:
        feed = Feed(bag, {'odometry': '/odometry'}, decode=decode)
        assert len(list(feed)) == 1 and feed.lost == ['1 message of /odometry: 0 bytes are no message',
                                                      '1 message of /odometry: 2 bytes are no message']


def test_fields_of_another_type_are_counted(tmp_path):
    """A header that has one field more, as that of ROS 1, is none of the installed class, which a conversion needs."""
    kind = 'geometry_msgs/msg/PoseStamped'
    text = full(kind).replace('MSG: std_msgs/Header\n', 'MSG: std_msgs/Header\nuint32 seq\n')
    writer = McapWriter(str(tmp_path / 'bag.mcap'))
    writer.start('ros2')
    channel = writer.register_channel('/pose', 'cdr', writer.register_schema(kind, 'ros2msg', text.encode()))
    data = b'\0\1\0\0' + bytes(12) + b'\1\0\0\0' + bytes(8) + np.array([0.0] * 6 + [1.0]).tobytes()
    writer.add_message(channel, START, data, START)
    writer.finish()
    with Bag(tmp_path / 'bag.mcap') as bag:
        feed = Feed(bag, {'odometry': '/pose'})
        assert not list(feed) and sum(feed.problems.values()) == 1


def test_chunks_without_an_index_are_read(tmp_path):
    rows = recorded(2.0)
    writer = McapWriter(str(tmp_path / 'bag.mcap'), chunk_size=2000, index_types=IndexType.ALL & ~IndexType.MESSAGE)
    writer.start('ros2')
    channels = {}
    for topic, time_ns, message in rows:
        if topic not in channels:
            schema = writer.register_schema(message.__msgtype__, 'ros2msg', full(message.__msgtype__).encode())
            channels[topic] = writer.register_channel(topic, 'cdr', schema)
        writer.add_message(channels[topic], time_ns, make.cdr(message), time_ns)
    writer.finish()
    with Bag(tmp_path / 'bag.mcap') as bag:
        assert list(bag.messages()) == keys(rows)


def set_by(rows, steps):
    """Rows of a clock that is set by some seconds at some rows: times of recording and stamps."""
    found, offset = [], 0.0
    for k, (topic, time_ns, _) in enumerate(rows):
        offset += steps.get(k, 0.0)
        time = 1e-9 * time_ns + offset
        number = k
        message = make.odometry(time, x=float(number)) if topic == '/odometry' else make.doa(time, 0.3)
        found.append((topic, round(time * SECOND), message))
    return found


@pytest.mark.parametrize('storage', list(StoragePlugin))
@pytest.mark.parametrize('steps', [{120: 3e8}, {120: 6.0}, {120: -3.0}, {120: -86_400.0}, {60: -3.5, 150: 1e6},
                                   {60: -2.0, 150: -2.0}], ids=str)
def test_a_clock_that_was_set_begins_a_segment(tmp_path, storage, steps):
    """In the order of recording, also where the times of both clocks overlap; the gap is none of the recorded time."""
    rows = set_by(recorded(), steps)
    write(tmp_path / 'bag', rows, storage)
    with Bag(tmp_path / 'bag') as bag:
        assert list(bag.messages()) == keys(rows)
        assert len(bag.segments) == 1 + len(steps) and bag.length == pytest.approx(8.0, abs=0.3)
        feed = Feed(bag, {'odometry': '/odometry', 'doa': '/doa'})
        found = list(feed)
        assert [record.arrival for record in found] == pytest.approx([1e-9 * row[1] for row in rows], abs=1e-6)
        changes = [k for k in range(1, len(found)) if found[k].segment != found[k - 1].segment]
        assert changes == sorted(steps) and len(feed.notes) == len(steps)
        played = [record.message.pose.pose.position.x for record in Feed(bag, {'odometry': '/odometry'}, start=2.0, stop=5.0)]
        whole = [record for record in found if record.name == 'odometry']
        first = next(k for k, record in enumerate(whole) if record.message.pose.pose.position.x == played[0])
        assert 38 <= first <= 44 and 58 <= len(played) <= 64
        assert played == [record.message.pose.pose.position.x for record in whole[first:first + len(played)]]


def test_a_file_in_no_order_is_sorted(tmp_path):
    """One topic after the other, or at random: no clock was set."""
    rows = recorded()
    write(tmp_path / 'topics', sorted(rows, key=lambda row: row[0]))
    mixed = [rows[k] for k in np.random.default_rng(3).permutation(len(rows))]
    write(tmp_path / 'mixed', mixed)
    for name in ('topics', 'mixed'):
        with Bag(tmp_path / name) as bag:
            assert list(bag.messages()) == keys(rows) and len(bag.segments) == 1


def test_the_clock_of_stamps_may_be_set_and_a_single_one_may_be_wrong(tmp_path):
    rows = recorded(6.0)
    changed = []
    for k, (topic, time_ns, _) in enumerate(rows):
        time = 1e-9 * (time_ns - START) + (5000.0 if k < 90 else 9_000_000.0) + (1e6 if k in (20, 140) else 0.0)
        message = make.odometry(time, x=float(k)) if topic == '/odometry' else make.doa(time, 0.3)
        changed.append((topic, time_ns, message))
    write(tmp_path / 'bag', changed)
    with Bag(tmp_path / 'bag') as bag:
        feed = Feed(bag, {'odometry': '/odometry', 'doa': '/doa'})
        found = list(feed)
    assert len(found) == len(rows)
    segments = np.array([record.segment for record in found])
    assert set(segments[:90]) == {0} and set(segments[90:]) == {1} and len(feed.notes) == 1
    arrivals = np.array([record.arrival for record in found])
    assert arrivals[:90].max() < 5010.0 and 9_000_000.0 < arrivals[90:].min() < arrivals[90:].max() < 9_000_010.0


@pytest.mark.parametrize('rate', [0.0, 1.0])
def test_stamps_that_were_not_set_tell_of_no_clock(tmp_path, rate):
    """All of them are zero: what was recorded has the times of recording. A simulation begins with one that is."""
    write(tmp_path / 'bag', [('/odometry', START + k * SECOND // 20, make.odometry(0.05 * rate * k)) for k in range(40)])
    with Bag(tmp_path / 'bag') as bag:
        arrivals = [one.arrival for one in Feed(bag, {'odometry': '/odometry'})]
    assert arrivals == pytest.approx([0.05 * k + (0.0 if rate else make.EPOCH) for k in range(40)], abs=1e-6)


@pytest.mark.parametrize('start', [0.0, 0.52])
def test_what_comes_before_the_first_stamp_has_its_time(tmp_path, start):
    rows = []
    for k in range(20):
        time_ns, stamp = START + k * SECOND // 20, 100.0 + 0.05 * k
        rows.append(('/camera/camera_info', time_ns, make.camera_info(stamp)))
        rows += [('/odometry', time_ns + SECOND // 100, make.odometry(stamp))] if k > 2 else []
    write(tmp_path / 'bag', rows)
    with Bag(tmp_path / 'bag') as bag:
        topics = {'camera/camera_info': '/camera/camera_info', 'odometry': '/odometry'}
        arrivals = [one.arrival for one in Feed(bag, topics, start=start)]
    assert arrivals == sorted(arrivals) and arrivals[0] == pytest.approx(100.15 if not start else 100.55, abs=1e-6)


@pytest.mark.parametrize('name', ['split_overlap', 'two_recorders'])
def test_the_folders_of_the_field(name):
    if not FIELD_CASES.is_dir():
        pytest.skip('needs ../shared/data/field_cases')
    with Bag(FIELD_CASES / 'bags' / name) as bag, Bag(FIELD_CASES / 'bags' / 'ref') as whole:
        assert list(bag.messages()) == list(whole.messages())


@pytest.mark.parametrize('name', ['a:b', 'a#b?c', '100%', 'with spaces', '~'])
@pytest.mark.parametrize('storage', list(StoragePlugin))
def test_a_file_may_have_any_name(tmp_path, storage, name):
    rows = recorded(1.0)
    file = write(tmp_path / 'bag', rows, storage)
    file = file.rename(tmp_path / f'{name}{file.suffix}')
    with Bag(file) as bag:
        assert list(bag.messages()) == keys(rows)
    with Bag(file.rename(tmp_path / f'{name}{file.suffix.upper()}')) as bag:    # of a FAT disk
        assert list(bag.messages()) == keys(rows)
