"""Measured orientation of the gimbal that carries the rig's camera. The layout is specific to this project."""

import struct
from dataclasses import dataclass

import numpy as np

from av_common.frames import is_orientation
from av_sim_bridge.wire.error import WireError, check_magic, check_number, check_time, unpack

MAGIC = 1234567951  # own
VERSION = 1  # of the layout
_LAYOUT = struct.Struct('<3i1d5f')
MOST_VARIANCE = 10.0    # rad^2, more than that of an unknown direction


@dataclass(frozen=True)
class GimbalSample:
    """Orientation of the gimbal at one time.

    Parameters:
        sequence: number of the sample, increasing by one.
        time (s): time of the measurement on the sender's clock.
        orientation_wxyz ((4,)): rotation (w, x, y, z) from the gimbal's frame (x along the line of sight, y left) to the
            body's (x forward, y left, z up).
        variance (rad^2): of the error about each axis.
    """

    sequence: int
    time: float
    orientation_wxyz: np.ndarray
    variance: float


def encode_gimbal(sample: GimbalSample) -> bytes:
    """The 40 bytes of one sample."""
    return _LAYOUT.pack(MAGIC, VERSION, sample.sequence, sample.time, *sample.orientation_wxyz, sample.variance)


def decode_gimbal(datagram: bytes) -> GimbalSample:
    """Decode one sample. Raises WireError."""
    magic, version, sequence, time, *orientation, variance = unpack(_LAYOUT, datagram, 'gimbal')
    check_magic(magic, MAGIC, 'gimbal')
    if version != VERSION:
        raise WireError(f'gimbal: version {version}, {VERSION} expected')
    check_number(sequence, 'gimbal: sequence')
    check_time(time, 'gimbal')
    norm = float(np.linalg.norm(orientation))
    if not is_orientation(orientation):
        raise WireError(f'gimbal: quaternion has norm {norm:.3g}, expected 1')
    if not 0.0 <= variance <= MOST_VARIANCE:
        raise WireError(f'gimbal: variance is {variance:g}, expected 0 to {MOST_VARIANCE:g}')
    return GimbalSample(sequence, time, np.array(orientation) / norm, variance)
