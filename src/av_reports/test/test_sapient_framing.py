"""Messages on a stream: a length of 4 bytes, little-endian, and the message, in pieces of any size."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from av_reports.sapient.output import FrameReader, FramingError, frame


def test_the_length_is_little_endian():
    assert frame(b'x' * 258) == b'\x02\x01\x00\x00' + b'x' * 258


@given(st.lists(st.binary(min_size=1, max_size=40), max_size=8), st.integers(1, 50))
def test_messages_arrive_whole_and_in_order_however_the_stream_is_cut(messages, size):
    stream = b''.join(map(frame, messages))
    reader, got = FrameReader(), []
    for start in range(0, len(stream), size):
        got += reader.feed(stream[start:start + size])
    assert got == messages


@pytest.mark.parametrize('length', [b'\xff\xff\xff\xff', b'\x65\0\0\0', b'\0\0\0\0', b'GET ', b'<?xm'])
def test_a_length_that_no_message_has_ends_the_stream_before_any_memory_is_taken(length):
    with pytest.raises(FramingError, match='expected 1 to 100'):
        FrameReader(100).feed(length)


@given(st.lists(st.binary(max_size=60), max_size=10))
def test_rubbish_gives_bounded_messages_or_an_error(pieces):
    reader = FrameReader(50)
    try:
        for piece in pieces:
            assert all(0 < len(message) <= 50 for message in reader.feed(piece))
    except FramingError:
        pass
    assert len(reader._pending) <= 50 + 4 + 60


def test_an_empty_message_is_not_sent():
    with pytest.raises(FramingError):
        frame(b'')
