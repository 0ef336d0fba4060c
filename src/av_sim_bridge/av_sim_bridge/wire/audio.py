"""Audio datagrams: interleaved samples, without a header (RFlySim) or with a header specific to this project."""

import struct
from dataclasses import dataclass

import numpy as np

from av_sim_bridge.wire.error import WireError, check_number, check_time

MAGIC = 1234567960  # own
MOST_BYTES = 65_507  # of a UDP datagram: 65,535 less the headers of IP and UDP
_HEADER = struct.Struct('<4i1d')   # magic, packet length with header, sequence, frames in the packet, time
HEADER_BYTES = _HEADER.size
_TYPES = {'s16le': ('<i2', 32768.0), 'f32le': ('<f4', 1.0)}  # numpy type and full scale
MOST_CHANNELS, MOST_RATE = 64, 384_000
_LOUDEST = 16.0   # float samples beyond this (24 dB over full scale) are refused


@dataclass(frozen=True)
class AudioFormat:
    """Format of the samples in datagrams. Raises ValueError for an impossible one.

    Parameters:
        sample_format: `s16le` or `f32le`.
        channels (1 to MOST_CHANNELS): number of interleaved channels.
        sample_rate (Hz, 1 to MOST_RATE): sample rate of each channel.
    """

    sample_format: str = 's16le'
    channels: int = 2
    sample_rate: int = 48_000

    def __post_init__(self) -> None:
        if self.sample_format not in _TYPES:
            raise ValueError(f'sample_format is {self.sample_format!r}, expected one of {", ".join(_TYPES)}')
        if not (1 <= self.channels <= MOST_CHANNELS and 1 <= self.sample_rate <= MOST_RATE):
            raise ValueError(f'channels is {self.channels} and sample_rate {self.sample_rate}, expected positive numbers up to '
                             f'{MOST_CHANNELS} and {MOST_RATE}')

    @property
    def frame_bytes(self) -> int:
        """Size of one sample of every channel (bytes)."""
        return self.channels * self.dtype.itemsize

    @property
    def dtype(self) -> np.dtype:
        """Type of a sample in a datagram."""
        return np.dtype(_TYPES[self.sample_format][0])

    def encode(self, samples: np.ndarray) -> bytes:
        """The encoded samples (n, channels), full scale 1; `s16le` clips samples beyond full scale."""
        scale = _TYPES[self.sample_format][1]
        if self.dtype == np.int16:
            samples = np.clip(np.rint(samples * scale), -scale, scale - 1)
        return np.ascontiguousarray(samples, self.dtype).tobytes()

    def decode(self, data: bytes) -> np.ndarray:
        """Samples (n, channels) in the type of the datagram. Raises WireError for non-finite or far too large floats."""
        samples = np.frombuffer(data, self.dtype).reshape(-1, self.channels)
        if self.dtype == np.float32 and not (np.abs(samples) < _LOUDEST).all():
            raise WireError('audio: float samples are not finite or far beyond full scale')
        return samples

    def to_float(self, samples: np.ndarray) -> np.ndarray:
        """Samples (n, channels) in the type of the datagram as float32, full scale 1."""
        return samples.astype(np.float32) / np.float32(_TYPES[self.sample_format][1])


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
