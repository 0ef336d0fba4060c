"""A decoder of protobuf's wire format, written from its specification alone: it knows no message of SAPIENT."""

from __future__ import annotations

import struct


def varint(data, at):
    value = shift = 0
    while True:
        byte = data[at]
        value, at, shift = value | (byte & 127) << shift, at + 1, shift + 7
        if byte < 128:
            return value, at


def fields(data):
    """Values by field number, in their order: int, float of 8 or 4 bytes, or bytes."""
    found, at = {}, 0
    while at < len(data):
        key, at = varint(data, at)
        number, kind = key >> 3, key & 7
        if kind == 0:
            value, at = varint(data, at)
        elif kind == 1:
            value, at = struct.unpack_from('<d', data, at)[0], at + 8
        elif kind == 5:
            value, at = struct.unpack_from('<f', data, at)[0], at + 4
        elif kind == 2:
            size, at = varint(data, at)
            value, at = data[at:at + size], at + size
            assert len(value) == size
        else:
            raise AssertionError(f'wire type {kind}')
        found.setdefault(number, []).append(value)
    assert at == len(data)
    return found


def dig(data, *path):
    """The only value at a path of field numbers."""
    for number in path:
        data, = fields(data)[number]
    return data
