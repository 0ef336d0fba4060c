"""Capture from a PortAudio device in a separate process: `python3 -m av_audio.device_process DEVICE RATE BLOCK CHANNEL...`.

PortAudio lists devices only when it is initialised, and may block for ever after one is unplugged; a process can be
killed and restarted safely. It writes to its standard output: READY, then for every block a HEADER and the samples as
interleaved float32. When it cannot capture, it prints the reason on standard error and exits with 1.
"""

from __future__ import annotations

import signal
import struct
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from av_audio.file_source import pick_channels

READY = b'ready\n'
HEADER = struct.Struct('<d?')  # age in s of the first sample when the block is written; whether samples were lost before it
COMMON_RATES = (8000, 16_000, 22_050, 32_000, 44_100, 48_000, 96_000, 192_000)  # Hz, of converters


def load_sounddevice() -> Any:
    """The module sounddevice. Raises ImportError that names what to install."""
    try:
        import sounddevice
    except (ImportError, OSError) as error:
        raise ImportError(f'capture from devices needs the Python package sounddevice and the library portaudio '
                          f'(libportaudio2): {error}') from error
    return sounddevice


def find_device(choice: str) -> int:
    """Index of the capture device with an index, name or part of a name; the default device for ''.

    Raises ValueError that lists the devices when none or several match.
    """
    sounddevice = load_sounddevice()
    inputs = {device['index']: device for device in sounddevice.query_devices() if device['max_input_channels'] > 0}
    listing = '; '.join(f'{index}: {device["name"]} ({device["max_input_channels"]} channels)'
                        for index, device in inputs.items()) or 'none'
    if choice == '':
        default = sounddevice.default.device[0]
        if default not in inputs:
            raise ValueError(f'there is no default capture device; devices: {listing}')
        return default
    if choice.isdigit():
        if int(choice) not in inputs:
            raise ValueError(f'device={choice} is not a capture device; devices: {listing}')
        return int(choice)
    matching = ([index for index, device in inputs.items() if device['name'] == choice]
               or [index for index, device in inputs.items() if choice.lower() in device['name'].lower()])
    if len(matching) != 1:
        raise ValueError(f'device={choice!r} matches {len(matching)} capture devices; devices: {listing}')
    return matching[0]


def check_device(device: int, channels: int, sample_rate: int) -> None:
    """Check that a device can capture `channels` channels at `sample_rate` in Hz. Raises ValueError that names what it can.

    Parameters:
        device: index of the device.
        channels: number of channels.
        sample_rate (Hz): sample rate.
    """
    sounddevice = load_sounddevice()
    information = sounddevice.query_devices(device)

    def works(rate: int, count: int) -> bool:
        try:
            sounddevice.check_input_settings(device, count, 'float32', samplerate=rate)
        except (sounddevice.PortAudioError, ValueError):
            return False
        return True

    most = information['max_input_channels']
    if channels > most:
        raise ValueError(f'device {device} ({information["name"]}) has channels 0..{most - 1}, not {channels - 1}')
    if not works(sample_rate, channels):
        rates = [rate for rate in COMMON_RATES if works(rate, channels)]
        raise ValueError(f'device {device} ({information["name"]}) cannot capture {channels} channels at '
                         f'sample_rate={sample_rate}; with {channels} channels it can do {rates or "none of the common rates"}')


def capture(choice: str, sample_rate: int, block: int, channels: Sequence[int]) -> None:
    """Write blocks to standard output until it is closed.

    Parameters:
        choice: index, name or part of a name of the device; empty for the default.
        sample_rate (Hz): sample rate.
        block: samples per block.
        channels: channels of the device in the order of the microphones.

    Raises ValueError or ImportError when the device cannot capture like this.
    """
    sounddevice = load_sounddevice()
    device = find_device(choice)
    picked = pick_channels(sounddevice.query_devices(device)['max_input_channels'], channels, f'device {device}')
    check_device(device, max(picked) + 1, sample_rate)
    output = sys.stdout.buffer
    with sounddevice.InputStream(device=device, channels=max(picked) + 1, samplerate=sample_rate, dtype='float32') as stream:
        output.write(READY)
        output.flush()
        while True:
            samples, overflowed = stream.read(block)
            age = (block + stream.read_available) / sample_rate
            output.write(HEADER.pack(age, overflowed) + np.ascontiguousarray(samples[:, picked]).tobytes())
            output.flush()


def main() -> None:
    """Entry point."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent terminates this process
    choice, sample_rate, block, *channels = sys.argv[1:]
    try:
        capture(choice, int(sample_rate), int(block), [int(channel) for channel in channels])
    except BrokenPipeError:
        sys.stderr.close()
    except (ValueError, ImportError) as error:
        sys.exit(str(error))
    except load_sounddevice().PortAudioError as error:
        sys.exit(f'device {choice!r}: {error}')


if __name__ == '__main__':
    main()
