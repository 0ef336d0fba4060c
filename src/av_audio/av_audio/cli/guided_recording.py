"""Guided recordings: a person is told what to do, such as where to carry a loudspeaker for `calibrate`."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from av_audio.device_source import DeviceSource
from av_audio.ring_buffer import RingBuffer
from av_common.files import one_line

BUFFER_BYTES = 4_000_000    # 10 s of two channels at 48 kHz
SILENT_S = 5.0    # without samples, after which the device counts as lost


def record(source: DeviceSource, azimuths_deg: Sequence[float], dwell_s: float, sound: str | Path, truth: str | Path,
           ask: Callable[[str], object] = input) -> None:
    """Record a loudspeaker at each azimuth, and write the sound and a table of times and azimuths.

    Parameters:
        source: the device.
        azimuths_deg (deg): places, counter-clockwise from x of the array's frame.
        dwell_s (s): time at each.
        sound: sound file to write.
        truth: CSV file to write, as `calibrate --truth` reads it.
        ask: shows a text and returns when the person is there.

    Raises ValueError when the device cannot be opened or is lost, OSError when a file cannot be written.
    """
    requests = [f'{number} of {len(azimuths_deg)}: loudspeaker to {azimuth:+g} deg ({_in_words(azimuth)}), as high as the '
                'microphones and 2 m or more away; let it hiss and press Enter'
                for number, azimuth in enumerate(azimuths_deg, start=1)]
    record_sound(source, requests, dwell_s, sound, ask)
    with Path(truth).open('w', newline='', encoding='utf-8') as file:
        table = csv.writer(file)
        table.writerow(['time', 'azimuth_deg'])
        for k, azimuth in enumerate(azimuths_deg):
            table.writerows([[k * dwell_s, azimuth], [(k + 1) * dwell_s - 1e-3, azimuth]])


def record_sound(source: DeviceSource, requests: Sequence[str], dwell_s: float, path: str | Path,
                 ask: Callable[[str], object] = input) -> None:
    """Write what a device hears for `dwell_s` s after each request was fulfilled. Parameters and errors as of `record`.

    Whether the file can be written is tried before a person has worked for minutes.
    """
    import soundfile
    try:
        soundfile.write(BytesIO(), np.zeros((1, source.channels)), source.sample_rate, format=Path(path).suffix[1:])
    except (soundfile.LibsndfileError, TypeError, ValueError) as error:
        raise OSError(f'{path} cannot be written: {one_line(error)}; expected a name such as sound.wav') from error
    with Path(path).open('ab'):
        pass
    soundfile.write(str(path), np.concatenate(pieces(source, requests, dwell_s, ask)), source.sample_rate)


def pieces(source: DeviceSource, requests: Sequence[str], dwell_s: float, ask: Callable[[str], object]) -> list[NDArray]:
    """What a device hears (n, channels) for `dwell_s` s after each request was fulfilled; other parameters as of `record`."""
    buffer = RingBuffer(source.channels, BUFFER_BYTES)
    heard: list[NDArray] = []
    source.start(buffer)
    try:
        for request in requests:
            ask(request)
            heard.append(_next(buffer, round(dwell_s * source.sample_rate)))
    finally:
        source.stop()
    return heard


def _next(buffer: RingBuffer, count: int) -> NDArray:
    """The next `count` samples (count, channels) that arrive. Raises ValueError when none arrive."""
    while buffer.available:
        buffer.read()
    blocks: list[NDArray] = []
    while sum(map(len, blocks)) < count:
        if not buffer.wait(SILENT_S):
            raise ValueError(f'the device has sent nothing for {SILENT_S:g} s')
        blocks.append(buffer.read()[1])
    return np.concatenate(blocks)[:count]


def _in_words(azimuth_deg: float) -> str:
    names = ('in front', 'front left', 'left', 'back left', 'behind', 'back right', 'right', 'front right')
    return names[round(azimuth_deg / 45.0) % 8]
