"""The exception that all decoders raise, and checks that decoders share."""

import struct

import numpy as np
from numpy.typing import ArrayLike


class WireError(ValueError):
    """A datagram that violates the format of its stream."""


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


def check_finite(values: ArrayLike, name: str) -> None:
    """Raise WireError for the stream `name` if one of its values is infinite or NaN."""
    if not np.isfinite(values).all():
        raise WireError(f'{name}: values are not finite')
