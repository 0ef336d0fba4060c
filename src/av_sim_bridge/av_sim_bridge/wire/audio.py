"""Audio datagrams: interleaved samples, without a header (RFlySim) or with a header specific to this project."""

import struct
from dataclasses import dataclass

import numpy as np

from av_sim_bridge.wire.error import WireError, check_number, check_time

MAGIC = 1234567960
MOST_BYTES = 65_507
_HEADER = struct.Struct('<4i1d')   # magic, packet length with header, sequence, frames in the packet, time
MOST_CHANNELS, MOST_RATE = 64, 384_000
SAMPLE = np.dtype('<i2')
_FULL_SCALE = 32768.0


@dataclass(frozen=True)
class AudioFormat:
    """Format of the samples in datagrams. Raises ValueError for an impossible one.

    Parameters:
        channels (1 to MOST_CHANNELS): number of interleaved channels.
        sample_rate (Hz, 1 to MOST_RATE): sample rate of each channel.
    """

    channels: int = 2
    sample_rate: int = 48_000

    def __post_init__(self) -> None:
        if not (1 <= self.channels <= MOST_CHANNELS and 1 <= self.sample_rate <= MOST_RATE):
            raise ValueError(f'channels is {self.channels} and sample_rate {self.sample_rate}, expected positive numbers up to '
                             f'{MOST_CHANNELS} and {MOST_RATE}')

    @property
    def frame_bytes(self) -> int:
        """Size of one sample of every channel (bytes)."""
        return self.channels * SAMPLE.itemsize

    def encode(self, samples: np.ndarray) -> bytes:
        """The encoded samples (n, channels), full scale 1, clipped beyond it."""
        return np.ascontiguousarray(np.clip(np.rint(samples * _FULL_SCALE), -_FULL_SCALE, _FULL_SCALE - 1), SAMPLE).tobytes()

    def decode(self, data: bytes) -> np.ndarray:
        """Samples (n, channels) of 16 bits."""
        return np.frombuffer(data, SAMPLE).reshape(-1, self.channels)


@dataclass(frozen=True)
class AudioHeader:
    """Header of an audio datagram, specific to this project.

    Parameters:
        sequence: number of the datagram since the start of the stream.
        frames: number of samples of each channel in this datagram.
        time (s): capture time of the first sample on the sender's clock.
    """

    sequence: int
    frames: int
    time: float


def to_float(samples: np.ndarray) -> np.ndarray:
    """Samples of 16 bits as float32, full scale 1."""
    return samples.astype(np.float32) / np.float32(_FULL_SCALE)


def encode_audio(layout: AudioFormat, samples: np.ndarray, header: AudioHeader | None = None) -> bytes:
    """The datagram of a block of samples. Raises ValueError if it would be too large.

    Parameters:
        layout: format of the samples.
        samples (n, channels): samples, full scale 1.
        header: header, None for a datagram without one.
    """
    payload = layout.encode(samples)
    if header is not None:
        payload = _HEADER.pack(MAGIC, _HEADER.size + len(payload), header.sequence, header.frames,
                               header.time) + payload
    if len(payload) > MOST_BYTES:
        raise ValueError(f'audio: {len(payload)} bytes do not fit into a datagram of {MOST_BYTES}')
    return payload


def decode_header(layout: AudioFormat, datagram: bytes) -> AudioHeader | None:
    """The header of a datagram, None if it has none. Raises WireError if the header contradicts the datagram.

    Parameters:
        layout: format of the samples.
        datagram: content of the datagram.
    """
    if len(datagram) < _HEADER.size:
        return None
    magic, length, sequence, frames, time = _HEADER.unpack_from(datagram)
    if magic != MAGIC:
        return None
    if length != len(datagram) or frames < 1 or frames * layout.frame_bytes != len(datagram) - _HEADER.size:
        raise WireError(f'audio: {len(datagram)} bytes, but the header states {length} with {frames} frames '
                        f'of {layout.frame_bytes} bytes')
    check_number(sequence, 'audio: sequence')
    check_time(time, 'audio')
    return AudioHeader(sequence, frames, time)


def payload_of(datagram: bytes) -> bytes:
    """The samples after the header."""
    return datagram[_HEADER.size:]
