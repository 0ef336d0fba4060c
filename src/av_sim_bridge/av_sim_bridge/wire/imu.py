"""Inertial measurements of one vehicle."""

import struct
from dataclasses import dataclass

import numpy as np

from av_sim_bridge.wire.error import (
    MOST_ACCELERATION_M_S2,
    MOST_RATE_RAD_S,
    check_magic,
    check_number,
    check_time,
    check_within,
    unpack,
)

MAGIC = 1234567898  # RFlySim's
_LAYOUT = struct.Struct('<2i1d6f')


@dataclass(frozen=True)
class ImuSample:
    """Inertial measurement in FRD.

    Parameters:
        sequence: number of the sample, increasing by one.
        time (s): time of the measurement on the sender's clock.
        acceleration_frd (m/s^2, (3,)): specific force.
        rate_frd (rad/s, (3,)): angular rate.
    """

    sequence: int
    time: float
    acceleration_frd: np.ndarray
    rate_frd: np.ndarray


def encode_imu(sample: ImuSample) -> bytes:
    """The 40 bytes of one sample."""
    return _LAYOUT.pack(MAGIC, sample.sequence, sample.time, *sample.acceleration_frd, *sample.rate_frd)


def decode_imu(datagram: bytes) -> ImuSample:
    """Decode one sample. Raises WireError."""
    magic, sequence, time, *reals = unpack(_LAYOUT, datagram, 'imu')
    check_magic(magic, MAGIC, 'imu')
    check_number(sequence, 'imu: sequence')
    check_time(time, 'imu')
    check_within(reals[:3], MOST_ACCELERATION_M_S2, 'imu: acceleration')
    check_within(reals[3:], MOST_RATE_RAD_S, 'imu: rate')
    return ImuSample(sequence, time, np.array(reals[:3]), np.array(reals[3:]))
