"""The one error of every decoder, and the checks that decoders share."""

import struct

import numpy as np
from numpy.typing import ArrayLike


class WireError(ValueError):
    """A datagram that is not what its stream carries; the message says what is wrong with it."""


def unpack(layout: struct.Struct, datagram: bytes, name: str) -> tuple:
    """Unpack a datagram that must be exactly as long as its layout."""
    if len(datagram) != layout.size:
        raise WireError(f'{name}: {len(datagram)} bytes, {layout.size} expected')
    return layout.unpack(datagram)


def check_magic(magic: int, expected: int, name: str) -> None:
    """Raise WireError where the first number is not the stream's own."""
    if magic != expected:
        raise WireError(f'{name}: magic {magic}, {expected} expected')


def check_finite(values: ArrayLike, name: str) -> None:
    """Raise WireError where a number is infinite or not a number."""
    if not np.isfinite(values).all():
        raise WireError(f'{name}: contains numbers that are not finite')
