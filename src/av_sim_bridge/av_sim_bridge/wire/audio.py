"""Sound in datagrams: interleaved samples, bare as RFlySim sends them or behind a header of this project's own."""

import struct
from dataclasses import dataclass

import numpy as np

from av_sim_bridge.wire.error import WireError

MAGIC = 1234567960
MOST_BYTES = 65_507
_HEADER = struct.Struct('<4i1d')   # magic, packet length with header, sequence, frames in the packet, time
_TYPES = {'s16le': ('<i2', 32768.0), 'f32le': ('<f4', 1.0)}
_LOUDEST = 16.0   # a float sample beyond this (24 dB over full scale) is not sound


@dataclass(frozen=True)
class AudioFormat:
    """Layout of samples on the wire. Raises ValueError for an impossible one.

    Parameters:
        sample_format: `s16le` or `f32le`.
        channels: interleaved channels.
        sample_rate (Hz): samples a second of each channel.
    """

    sample_format: str = 's16le'
    channels: int = 2
    sample_rate: int = 48_000

    def __post_init__(self) -> None:
        if self.sample_format not in _TYPES:
            raise ValueError(f'sample_format: {self.sample_format!r}, one of {", ".join(_TYPES)} expected')
        if self.channels < 1 or self.sample_rate < 1:
            raise ValueError(f'channels {self.channels} and sample_rate {self.sample_rate} must be positive')

    @property
    def frame_bytes(self) -> int:
        """Bytes of one sample of every channel."""
        return self.channels * self.dtype.itemsize

    @property
    def dtype(self) -> np.dtype:
        """Type of a sample on the wire."""
        return np.dtype(_TYPES[self.sample_format][0])

    def encode(self, samples: np.ndarray) -> bytes:
        """Bytes of samples (n, channels) of full scale 1; louder ones are clipped in `s16le`."""
        scale = _TYPES[self.sample_format][1]
        if self.dtype == np.int16:
            samples = np.clip(np.rint(samples * scale), -scale, scale - 1)
        return np.ascontiguousarray(samples, self.dtype).tobytes()

    def decode(self, data: bytes) -> np.ndarray:
        """Samples (n, channels) of whole frames as they are on the wire. Raises WireError on impossible floats."""
        samples = np.frombuffer(data, self.dtype).reshape(-1, self.channels)
        if self.dtype == np.float32 and not (np.abs(samples) < _LOUDEST).all():
            raise WireError('audio: float samples that are not finite or far beyond full scale')
        return samples

    def to_float(self, samples: np.ndarray) -> np.ndarray:
        """Samples of the wire's type as float32 of full scale 1."""
        return samples.astype(np.float32) / np.float32(_TYPES[self.sample_format][1])


@dataclass(frozen=True)
class AudioHeader:
    """Header of an audio datagram, of this project.

    Parameters:
        sequence: datagrams since the stream began.
        frames: samples of each channel in this datagram.
        time (s): capture of the first sample.
    """

    sequence: int
    frames: int
    time: float


def encode_audio(layout: AudioFormat, samples: np.ndarray, header: AudioHeader | None = None) -> bytes:
    """One datagram of samples (n, channels). Raises ValueError where they do not fit into one."""
    payload = layout.encode(samples)
    if header is not None:
        payload = _HEADER.pack(MAGIC, _HEADER.size + len(payload), header.sequence, header.frames,
                               header.time) + payload
    if len(payload) > MOST_BYTES:
        raise ValueError(f'audio: {len(payload)} bytes do not fit into a datagram of {MOST_BYTES}')
    return payload


def decode_header(layout: AudioFormat, datagram: bytes) -> AudioHeader | None:
    """The header of a datagram, None where it is bare. Raises WireError where it contradicts the datagram."""
    if len(datagram) < _HEADER.size:
        return None
    magic, length, sequence, frames, time = _HEADER.unpack_from(datagram)
    if magic != MAGIC:
        return None
    if length != len(datagram) or frames * layout.frame_bytes != len(datagram) - _HEADER.size:
        raise WireError(f'audio: {len(datagram)} bytes, header says {length} with {frames} frames '
                        f'of {layout.frame_bytes} bytes')
    if sequence < 0 or not (np.isfinite(time) and time >= 0):
        raise WireError(f'audio: sequence {sequence} at {time} s')
    return AudioHeader(sequence, frames, time)


def payload_of(datagram: bytes) -> bytes:
    """What follows the header."""
    return datagram[_HEADER.size:]
