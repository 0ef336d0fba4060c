"""Bags that claim, or become, far more than they are: refused in one line, before memory is taken."""

import resource
import sqlite3
import struct
from unittest import mock

import bag_messages as make
import lz4.frame
import pytest
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, Header
from mcap.writer import CompressionType
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import zstd

from av_bags import Bag, BagError, BagWriter

GROWTH_KIB = 1_200_000    # the limit twice: as it is decompressed, and joined
MEGABYTE = bytes(1_000_000)


def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def bomb(megabytes=2000):
    """Zeros of so many megabytes, in some kilobytes."""
    compressor = zstd.ZstdCompressor(level=1)
    return b''.join([*(compressor.compress(MEGABYTE) for _ in range(megabytes)), compressor.flush()])


def mcap(path, compression, claimed):
    """A bag whose chunk claims a size, in its header and in the index."""
    with mock.patch('av_bags.writer.COMPRESSION', CompressionType[compression.upper()]), BagWriter(path) as writer:
        writer.add_topic('/odometry', make.ODOMETRY)
        for k in range(50):
            writer.write('/odometry', k, make.cdr(make.odometry(0.001 * k, x=float(k))))
    content, name = bytearray(path.read_bytes()), struct.pack('<I', len(compression)) + compression.encode()
    chunk, index = content.index(name), content.rindex(name)
    struct.pack_into('<Q', content, chunk - 12, claimed)
    struct.pack_into('<Q', content, index + len(name) + 8, claimed)
    path.write_bytes(content)


@pytest.mark.parametrize('compression', ['lz4', 'zstd'])
@pytest.mark.parametrize('claimed', [10**12, 2**63, 10, 0])
def test_a_chunk_that_is_not_what_it_claims_is_named(tmp_path, compression, claimed):
    path = tmp_path / 'bag.mcap'
    mcap(path, compression, claimed)
    before = peak()
    with pytest.raises(BagError, match='chunk') as error, Bag(path) as bag:
        list(bag.messages())
        raise BagError('; '.join(bag.problems))
    assert '\n' not in str(error.value) and peak() - before < GROWTH_KIB


@pytest.mark.parametrize(('compression', 'data'), [('zstd', bomb()), ('lz4', lz4.frame.compress(bytes(50_000_000)))],
                         ids=['zstd', 'lz4'])
@pytest.mark.parametrize(('claimed', 'said'), [(1000, 'more than the 1000 bytes that it claims'),
                                               (500_000_001, 'expected at most 500 MB')])
def test_no_more_is_decompressed_than_was_claimed(tmp_path, compression, data, claimed, said):
    """A file that breaks off behind its only chunk, as one that is being written."""
    builder = RecordBuilder()
    Header('ros2', '').write(builder)
    Chunk(compression, data, 1, 0, 0, claimed).write(builder)
    (tmp_path / 'bag.mcap').write_bytes(b'\x89MCAP0\r\n' + builder.end())
    before = peak()
    with pytest.raises(BagError, match=said):
        Bag(tmp_path / 'bag.mcap')
    assert peak() - before < 100_000


@pytest.mark.parametrize('mode', [CompressionMode.MESSAGE, CompressionMode.FILE])
def test_compressed_messages_and_files_have_a_limit(tmp_path, mode):
    writer = Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection('/odometry', make.ODOMETRY, typestore=make.TYPES)
        writer.write(topic, 1, make.cdr(make.odometry(0.001)))
    file, = (tmp_path / 'bag').glob('*.db3*')
    if mode is CompressionMode.MESSAGE:
        with sqlite3.connect(file) as database:
            database.execute('UPDATE messages SET data = ?', (bomb(),))
    else:
        file.write_bytes(bomb())
    before = peak()
    with pytest.raises(BagError, match='more than') as error, Bag(tmp_path / 'bag') as bag:
        list(bag.messages())
        raise BagError('; '.join(bag.problems))
    assert '\n' not in str(error.value) and peak() - before < GROWTH_KIB
