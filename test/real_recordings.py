"""Two-microphone recordings with known directions: a real drone's sound through a head's measured responses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile
from numpy.typing import NDArray
from scipy.signal import fftconvolve

DATA = Path(__file__).resolve().parents[2] / 'shared' / 'data'
CLIPS = DATA / 'drone_detection'
HEAD = DATA / 'kemar' / 'mit_kemar_normal_pinna.sofa'
COCO = DATA / 'models' / 'yolox_nano_coco.onnx'

needs_data = pytest.mark.skipif(not DATA.exists(), reason=f'the real recordings are not at {DATA}')


def head_responses() -> tuple[NDArray, NDArray, int]:
    """Azimuths (n,) in degrees of the horizontal ring, responses (n, 2, taps) left and right, sample rate."""
    import h5py

    with h5py.File(HEAD) as sofa:
        positions, responses = sofa['SourcePosition'][:], sofa['Data.IR'][:]
        rate = int(sofa['Data.SamplingRate'][0])
    level = np.abs(positions[:, 1]) < 0.5
    return (positions[level, 0] + 180.0) % 360.0 - 180.0, responses[level], rate


def moving_drone(path: Path, azimuths_deg: NDArray, step_s: float) -> None:
    """Write a WAV in which a real drone moves evenly from each azimuth (multiples of 5 degrees) to the next in `step_s`.

    In between the two measured responses are mixed by the share of the way, which below 4 kHz, where 5 degrees are a small
    part of a period, is their interpolation.
    """
    known, responses, rate = head_responses()
    clip, clip_rate = soundfile.read(CLIPS / 'audio' / 'DRONE_001.flac', always_2d=True)
    assert clip_rate == rate
    step = round(step_s * rate)
    voice = np.resize(clip[:, 0], step * (len(azimuths_deg) - 1))
    sample = np.arange(len(voice))
    out = np.zeros((len(voice), 2))
    for k, azimuth in enumerate(azimuths_deg):
        nearest = np.argmin(np.abs((known - azimuth + 180.0) % 360.0 - 180.0))
        share = np.clip(1.0 - np.abs(sample - k * step) / step, 0.0, None)
        out += share[:, None] * np.stack([fftconvolve(voice, response)[:len(voice)] for response in responses[nearest]], 1)
    soundfile.write(path, 0.5 * out / np.abs(out).max(), rate, subtype='PCM_16')


def boxes_of(clip: str) -> dict[int, NDArray]:
    """First box (x, y, width, height) in pixels of each labelled frame of a clip."""
    boxes: dict[int, NDArray] = {}
    for line in (CLIPS / 'labels' / f'{clip}.csv').read_text().splitlines()[1:]:
        cells = line.split(',')
        boxes.setdefault(int(cells[0]), np.array(cells[2:6], float))
    return boxes
