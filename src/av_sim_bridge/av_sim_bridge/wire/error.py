"""The exception that all decoders raise, and the limits of numbers in datagrams: nothing behind a decoder meets others."""

import struct

import numpy as np
from numpy.typing import ArrayLike

LATEST_S = 4e9            # largest time on a sender's clock, in seconds of Unix time the year 2096
FARTHEST_M = 1e6  # beyond any map; as below, larger numbers are garbage
FASTEST_M_S = 1e5  # 300 times the speed of sound
MOST_ACCELERATION_M_S2 = 1e7  # a million g, of collisions in a simulator
MOST_ANGLE_RAD = 1e3      # angles need not be wrapped
MOST_RATE_RAD_S = 1e4  # 1,600 turns a second
MOST_RPM = 1e6  # 20 times the fastest motor
MOST_PIXEL = 1e5  # ten times the largest image


class WireError(ValueError):
    """A datagram that violates the format of its stream."""


class UndatedError(WireError):
    """A datagram whose time cannot be converted to ROS time."""


class ForeignSenderError(WireError):
    """A datagram of another sender than the one of its stream; the message names both.

    Parameters:
        stream: name of the stream.
        sender: address and port of the datagram's sender.
        present: those of the one that the stream is taken from.
    """

    def __init__(self, stream: str, sender: tuple, present: tuple) -> None:
        super().__init__(f'{stream}: {sender[0]}:{sender[1]} sends while {present[0]}:{present[1]} does')


def unpack(layout: struct.Struct, datagram: bytes, name: str) -> tuple:
    """The fields of a datagram. Raises WireError unless it has exactly the size of its layout.

    Parameters:
        layout: layout of the fields.
        datagram: content of the datagram.
        name: name of the stream, for the error message.
    """
    if len(datagram) != layout.size:
        raise WireError(f'{name}: {len(datagram)} bytes, expected {layout.size}')
    return layout.unpack(datagram)


def check_magic(magic: int, expected: int, name: str) -> None:
    """Raise WireError for the stream `name` unless its magic number is `expected`."""
    if magic != expected:
        raise WireError(f'{name}: magic {magic}, expected {expected}')


def check_within(values: ArrayLike, limit: float, name: str) -> None:
    """Raise WireError unless all values are finite and between -limit and limit.

    Parameters:
        values: numbers of any shape.
        limit: largest absolute value.
        name: name of the stream and of the quantity, for the error message.
    """
    beyond = np.asarray(values)[~(np.abs(values) <= limit)]
    if beyond.size:
        raise WireError(f'{name} is {beyond.flat[0]:g}, not finite or beyond +-{limit:g}')


def check_time(time: float, name: str) -> None:
    """Raise WireError for the stream `name` unless a time on the sender's clock (s) is 0 to LATEST_S."""
    if not 0.0 <= time <= LATEST_S:
        raise WireError(f'{name}: time is {time:g} s, expected 0 to {LATEST_S:g} s')


def check_number(number: int, name: str, most: int = 2**31 - 1) -> None:
    """Raise WireError unless an id, a count or a sequence number is 0 to `most`.

    Parameters:
        number: the number.
        name: name of the stream and of the number, for the error message.
        most: largest number.
    """
    if not 0 <= number <= most:
        raise WireError(f'{name} is {number}, expected 0 to {most}')
