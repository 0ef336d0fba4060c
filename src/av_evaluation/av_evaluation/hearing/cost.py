"""Processor time and memory of the localizer."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
import timeit
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import soundfile
from numpy.typing import NDArray
from scipy import fft

from av_audio.localizer import Localizer, LocalizerSettings
from av_evaluation.hearing.accuracy import PAIR
from av_evaluation.hearing.figures import Figure
from av_evaluation.hearing.scenes import pyroomacoustics_locator
from av_evaluation.hearing.signals import RATE, add_noise, flat

HOP_S = 0.05


def speed() -> Iterator[Figure]:
    """Times from samples to direction of the localizer and of pyroomacoustics, and of the FFTs that a GCC needs."""
    rng = np.random.default_rng(41)
    window = add_noise(rng, flat(rng, 0.5, np.array([0.0, 2e-4])), 10.0).astype(np.float32)
    localizer = Localizer(PAIR, RATE, LocalizerSettings(hop_s=HOP_S))
    localizer.process(window, 0)
    hop = window[:round(HOP_S * RATE)]

    def estimate() -> None:
        localizer.process(hop, localizer.next_sample)

    channels = np.ascontiguousarray(window.T)

    def transforms() -> None:
        left, right = fft.rfft(channels[0]), fft.rfft(channels[1])
        fft.irfft(left * right.conj())

    locate = pyroomacoustics_locator('SRP')
    times = interleaved_times(estimate, transforms, lambda: locate(window))
    localizer_ms, fft_ms, other_ms = np.median(times, axis=0)
    over_transforms, of_other = np.median(times[:, [0, 2]] / times[:, [1, 0]], axis=0)
    yield Figure('one estimate of 0.5 s', localizer_ms, 'ms')
    yield Figure('its FFTs: two forward, one inverse', fft_ms, 'ms')
    yield Figure('estimate over FFTs', over_transforms, '', 10.0)
    yield Figure('Localizer at a hop of 50 ms: share of one core', 0.1 * localizer_ms / HOP_S, '%', 10.0)
    yield Figure('pyroomacoustics SRP-PHAT, 1 degree grid', other_ms, 'ms')
    yield Figure('pyroomacoustics over estimate', of_other, '', at_least=2.5)


def interleaved_times(*calls: Callable[[], object], rounds: int = 50, slice_s: float = 0.05) -> NDArray:
    """Processor time of each call in ms (rounds, calls); in a round every call is repeated for the same time.

    Processor time covers all threads and no other program. Within a round the speed of the machine is about constant.

    Parameters:
        calls: functions to measure.
        rounds: number of rounds.
        slice_s (s): time for each call in a round.
    """
    counts = [max(1, round(slice_s / min(timeit.repeat(call, number=1)))) for call in calls]
    times = [[timeit.timeit(call, number=count, timer=time.process_time) for call, count in zip(calls, counts, strict=True)]
             for _ in range(rounds)]
    return 1e3 * np.array(times) / counts


def node() -> Iterator[Figure]:
    """Share of a core that doa_node uses at a hop of 50 ms, with frames of audio_node. Raises ImportError without ROS."""
    import rclpy  # noqa: F401
    with tempfile.TemporaryDirectory() as folder:
        array, sound = Path(folder) / 'pair.yaml', Path(folder) / 'sound.wav'
        PAIR.save(array)
        rng = np.random.default_rng(43)
        soundfile.write(sound, add_noise(rng, flat(rng, 5.0, np.array([0.0, 2e-4])), 10.0), RATE)
        source = start_node('audio_node', f'file:={sound}', 'loop:=true')
        localizer = start_node('doa_node', f'array_file:={array}', f'hop:={HOP_S}')
        try:
            time.sleep(6.0)
            before, begin = cpu_seconds(localizer.pid), time.monotonic()
            time.sleep(15.0)
            used = cpu_seconds(localizer.pid) - before
            yield Figure('doa_node at a hop of 50 ms: share of one core', 100.0 * used / (time.monotonic() - begin), '%', 10.0)
        finally:
            for process in (localizer, source):
                process.terminate()
                process.wait(10.0)


def start_node(name: str, *parameters: str) -> subprocess.Popen:
    """Start a node of this package in a separate process."""
    options = [option for parameter in parameters for option in ('-p', parameter)]
    program = f'from av_audio.nodes.{name} import main; main()'
    return subprocess.Popen([sys.executable, '-c', program, '--ros-args', *options])


def cpu_seconds(process_id: int) -> float:
    """Processor time in s that a process has used (Linux)."""
    fields = Path(f'/proc/{process_id}/stat').read_text(encoding='ascii').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def memory() -> Iterator[Figure]:
    """Growth of the peak memory over an hour of sound in blocks of 1600 samples."""
    rng = np.random.default_rng(42)
    block = add_noise(rng, flat(rng, 1600 / RATE, np.array([0.0, 2e-4])), 10.0).astype(np.float32)
    localizer = Localizer(PAIR, RATE, LocalizerSettings(hop_s=0.5))
    minute = range(60 * RATE // len(block))
    for _ in minute:
        localizer.process(block, localizer.next_sample)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(60):
        for _ in minute:
            localizer.process(block, localizer.next_sample)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield Figure('growth of the peak memory over an hour of sound', (after - before) / 1024.0, 'MiB', 1.0)
