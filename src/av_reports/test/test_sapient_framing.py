"""Messages on a stream: a length of 4 bytes, little-endian, and the message."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from av_reports.sapient.output import frame, next_message


def read(stream):
    """The messages of a stream, until it ends or raises."""
    async def all_of_it():
        reader, messages = asyncio.StreamReader(), []
        reader.feed_data(stream)
        reader.feed_eof()
        try:
            while True:
                messages.append(await next_message(reader))
        except asyncio.IncompleteReadError:
            return messages
    return asyncio.run(all_of_it())


def test_the_length_is_little_endian():
    assert frame(b'x' * 258) == b'\x02\x01\x00\x00' + b'x' * 258


@settings(deadline=None)
@given(st.lists(st.binary(min_size=1, max_size=40), max_size=8), st.binary(max_size=3))
def test_messages_arrive_whole_and_in_order(messages, rest):
    assert read(b''.join(map(frame, messages)) + rest) == messages


@pytest.mark.parametrize('length', [b'\xff\xff\xff\xff', b'\x01\0\x01\0', b'\0\0\0\0', b'GET ', b'<?xm'])
def test_a_length_that_no_message_has_ends_the_stream_before_any_memory_is_taken(length):
    with pytest.raises(ValueError, match='expected 1 to 65536'):
        read(length)
