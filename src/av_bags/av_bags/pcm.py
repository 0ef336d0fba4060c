"""Samples of bytes, in the formats that audio_common and GStreamer name."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FORMATS = {'S16LE': ('<i2', 32768.0), 'S32LE': ('<i4', 2147483648.0), 'F32LE': ('<f4', 1.0)}


def decode(data: bytes, sample_format: str, channels: int) -> NDArray:
    """Samples (n, channels) in float32, full scale 1, of interleaved bytes.

    Parameters:
        data: whole samples of all channels.
        sample_format: one of FORMATS.
        channels: number of channels.

    Raises ValueError for an unknown format or an incomplete sample.
    """
    kind, full_scale = _format(sample_format)
    if channels < 1 or len(data) % (channels * np.dtype(kind).itemsize):
        raise ValueError(f'{len(data)} bytes are not a whole number of samples of {channels} channels in {sample_format}')
    return (np.frombuffer(data, kind).reshape(-1, channels) / full_scale).astype(np.float32)


def _format(sample_format: str) -> tuple[str, float]:
    if sample_format.upper() not in FORMATS:
        raise ValueError(f'sample format {sample_format!r}, expected one of {", ".join(FORMATS)}')
    return FORMATS[sample_format.upper()]
