"""What an estimate costs."""

from __future__ import annotations

import resource
import timeit
from collections.abc import Callable, Iterator

import numpy as np
from scipy import fft

from av_audio.benchmark.accuracy import PAIR
from av_audio.benchmark.figures import Figure
from av_audio.benchmark.scenes import pyroomacoustics_azimuth
from av_audio.benchmark.signals import RATE, add_noise, flat
from av_audio.localizer import Localizer, LocalizerSettings

HOP_S = 0.05


def speed() -> Iterator[Figure]:
    """Times of one two-microphone estimate, of the FFTs it needs, and of pyroomacoustics; the best of many runs."""
    rng = np.random.default_rng(41)
    window = add_noise(rng, flat(rng, 0.5, np.array([0.0, 2e-4])), 10.0).astype(np.float32)
    localizer = Localizer(PAIR, RATE, LocalizerSettings(hop_s=HOP_S))
    localizer.process(window, 0)
    hop = window[:round(HOP_S * RATE)]

    def estimate() -> None:
        localizer.process(hop, localizer.next_sample)

    channels = np.ascontiguousarray(window.T)

    def transforms() -> None:
        spectra = fft.rfft(channels, axis=1)
        fft.irfft(spectra[0] * spectra[1].conj())

    own, unavoidable = best(estimate), best(transforms)
    yield Figure('one estimate of 0.5 s', own, 'ms')
    yield Figure('its FFTs: two forward, one inverse', unavoidable, 'ms')
    yield Figure('estimate over FFTs', own / unavoidable, '', 3.0)
    yield Figure('Localizer at a hop of 50 ms: share of one core', 0.1 * own / HOP_S, '%', 10.0)
    other = best(lambda: pyroomacoustics_azimuth('SRP', PAIR, window, RATE), 3)
    yield Figure('pyroomacoustics SRP-PHAT, 1 degree grid', other, 'ms')
    yield Figure('pyroomacoustics over estimate', other / own, '', at_least=10.0)


def best(call: Callable[[], object], repeat: int = 15) -> float:
    """Shortest time of a call in ms."""
    number = max(1, int(0.02 / max(timeit.timeit(call, number=1), 1e-6)))
    return 1e3 * min(timeit.repeat(call, number=number, repeat=repeat)) / number


def memory() -> Iterator[Figure]:
    """Growth of the process over an hour of sound in blocks of 1600 samples."""
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
