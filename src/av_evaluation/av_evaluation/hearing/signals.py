"""Sound with known delays: sums of sinusoids with exact delays, and recordings that are delayed by phase shifts.

Sources take random numbers, a duration in s and delays (m,) in s, and return sound (n, m): channel k is delayed by delays[k].
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy import signal

from av_audio.file_source import read_sound
from av_simulator.sound.source_signals import SourceSignal
from av_simulator.sound.stream import band_power

RATE = 48_000  # Hz
BAND_HZ = (200.0, 4000.0)  # of noise and ratios: that of the localizer

SOUNDS = Path('drone_detection', 'audio')  # in the folder of recordings

Source = Callable[[Generator, float, NDArray], NDArray]


def flat(rng: Generator, seconds: float, delays: NDArray, band_hz: tuple[float, float] = BAND_HZ, slope: float = 0.0
         ) -> NDArray:
    """Gaussian noise with amplitudes f^-slope inside the band: sinusoids at a distance of 0.5 / seconds."""
    count = round(seconds * RATE)
    frequencies = np.fft.rfftfreq(2 * count, 1.0 / RATE)
    inside = (frequencies >= band_hz[0]) & (frequencies <= band_hz[1])
    spectrum = np.where(inside, rng.normal(size=inside.size) + 1j * rng.normal(size=inside.size), 0.0)
    return delayed(spectrum / np.maximum(frequencies, 1.0) ** slope, frequencies, delays, count)


def comb(rng: Generator, seconds: float, delays: NDArray, fundamental_hz: float) -> NDArray:
    """Harmonics of equal amplitude up to 4.5 kHz, of a fundamental that wanders by 2 % once a second, as wing beats do."""
    time = np.arange(round(seconds * RATE))[:, None] / RATE - delays
    turn = np.exp(2j * np.pi * fundamental_hz * (time + 0.02 / (2.0 * np.pi) * np.sin(2.0 * np.pi * (time + rng.uniform()))))
    amplitudes = np.exp(2j * np.pi * rng.uniform(size=int(4500.0 / fundamental_hz)))
    return np.asarray(np.polynomial.polynomial.polyval(turn, np.concatenate([[0.0], amplitudes])).real)


def rotors(rng: Generator, seconds: float, delays: NDArray, decay: float = 0.5) -> NDArray:
    """Four rotors, and broadband noise of equal power per octave 10 dB below them.

    The rotors are harmonics k of 150 to 220 Hz with amplitudes k^-decay; their speeds vary by 0.3 %. A decay of 0.5 gives
    equal power per octave, the mean of the real drone recordings in shared/data (within 2 dB from 200 to 4000 Hz); 0 gives
    equal amplitudes, similar to a nearby drone.
    """
    time = np.arange(round(seconds * RATE))[:, None] / RATE - delays
    tones = np.zeros(time.shape)
    for _ in range(4):
        fundamental, wander_hz = rng.uniform(150.0, 220.0), rng.uniform(0.2, 2.0)
        wander = 0.003 / (2.0 * np.pi * wander_hz) * np.sin(2.0 * np.pi * (wander_hz * time + rng.uniform()))
        turn = np.exp(2j * np.pi * fundamental * (time + wander))
        harmonics = np.arange(1, int(4500.0 / fundamental))
        amplitudes = harmonics**-decay * np.exp(2j * np.pi * rng.uniform(size=harmonics.size))
        tones += (np.polynomial.polynomial.polyval(turn, np.concatenate([[0.0], amplitudes]))).real
    broadband = flat(rng, seconds, delays, (100.5, 5999.5), 0.5)
    return tones / tones[:, 0].std() + 10.0**-0.5 * broadband / broadband[:, 0].std()


bright_rotors: Source = partial(rotors, decay=0.0)


def recordings(data: Path) -> Source:
    """A source of random excerpts of the drone recordings, see `drone_files`."""
    clips = [load_clip(path) for path in drone_files(data)]

    def part(rng: Generator, length: int) -> NDArray:
        clip = clips[rng.integers(len(clips))]
        start = rng.integers(len(clip) - length)
        return np.asarray(clip[start:start + length])

    return partial(_excerpt, part)


def simulated(sound: SourceSignal) -> Source:
    """A source of random excerpts of the first minute of a sound of the simulator."""
    def part(rng: Generator, length: int) -> NDArray:
        start = int(rng.integers(60 * RATE))
        stream = sound.stream(RATE, [int(rng.integers(1000))], lambda times: np.zeros((len(times), 3)))
        return stream.read(start, start + length)

    return partial(_excerpt, part)


def _excerpt(part: Callable[[Generator, int], NDArray], rng: Generator, seconds: float, delays: NDArray) -> NDArray:
    """Some sound (n, m), delayed by phase shifts of the spectrum of a longer part of it, which is given by its length."""
    count, pad = round(seconds * RATE), RATE // 10
    length = count + 2 * pad
    return delayed(np.fft.rfft(part(rng, length)), np.fft.rfftfreq(length, 1.0 / RATE), delays, length, length)[pad:pad + count]


def drone_files(data: Path) -> list[Path]:
    """The recordings of drones in the folder of recordings. Raises FileNotFoundError where there are none."""
    files = sorted((data / SOUNDS).glob('DRONE_*.flac'))
    if not files:
        raise FileNotFoundError(f'no drone recordings in {data}')
    return files


def load_clip(path: Path, rate: int = RATE) -> NDArray:
    """First channel (n,) of a recording, resampled to a rate in Hz."""
    samples, recorded = read_sound(path, [0])
    return signal.resample_poly(samples[:, 0], rate, recorded)


def add_noise(rng: Generator, sound: NDArray, snr_db: float) -> NDArray:
    """Sound (n, m) with white noise, independent in each channel, at a signal-to-noise ratio inside BAND_HZ."""
    mixed = sound + scaled(rng.normal(size=sound.shape), sound, -snr_db)
    return 0.2 * mixed / mixed.std()


def scaled(noise: NDArray, sound: NDArray, over_db: float) -> NDArray:
    """Noise of a level relative to a sound, inside BAND_HZ at the first microphone.

    Parameters:
        noise (n, m), sound (n, m): samples.
        over_db (dB): level of the result over the sound.
    """
    wanted, present = (band_power(part[:, 0], RATE, BAND_HZ) for part in (sound, noise))
    return noise * np.sqrt(wanted / present * 10.0 ** (over_db / 10.0))


def delayed(spectrum: NDArray, frequencies: NDArray, delays: NDArray, count: int, period: int | None = None) -> NDArray:
    """Sound (count, m) of a spectrum (k,) at frequencies (k,) in Hz, after delays (m,) in s.

    Parameters:
        spectrum (k,), frequencies (k,) (Hz), delays (m,) (s): see above.
        count: number of samples.
        period: number of samples after which the sound repeats; twice `count` where None.
    """
    turned = spectrum * np.exp(-2j * np.pi * np.outer(delays, frequencies))
    return np.fft.irfft(turned, period or 2 * count, axis=1)[:, :count].T
