"""Stand-in for the library of that name: one device, which plays the sound file STAND_IN_SOUND over and over in real time."""

from __future__ import annotations

import os
import time

import numpy as np
import soundfile

SOUND, RATE = soundfile.read(os.environ['STAND_IN_SOUND'], dtype='float32', always_2d=True)


class PortAudioError(Exception):
    """As there."""


class default:  # noqa: N801  as there
    """The only device."""

    device = (0, 0)


def query_devices(device=None):
    one = {'index': 0, 'name': 'USB stand-in', 'max_input_channels': SOUND.shape[1]}
    return [one] if device is None else one


def check_input_settings(device, channels, dtype, samplerate):
    if samplerate != RATE:
        raise PortAudioError('Invalid sample rate')


class InputStream:
    """Blocks come when a sound card would have captured them."""

    read_available = 0

    def __init__(self, **_):
        self._taken, self._began = 0, time.monotonic()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def read(self, count):
        self._taken += count
        time.sleep(max(0.0, self._began + self._taken / RATE - time.monotonic()))
        return np.take(SOUND, range(self._taken - count, self._taken), axis=0, mode='wrap'), False


if __name__ == '__main__':
    print(query_devices())
