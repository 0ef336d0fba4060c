"""Signals of what else is heard outdoors: voices, engines, helicopters and sirens, from formulas without recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin

from av_common.config_reader import bounded
from av_simulator.sound.stream import CHUNK, LEVEL_S, SIGNAL_CHUNKS, Stream, Wander, filtered, spl_to_pascal, white_noise
from av_simulator.trajectories import Position

# Formants (Hz) of vowels, a male voice (Peterson and Barney, 1952).
_VOWELS_HZ = np.array([(730.0, 1090.0, 2440.0), (530.0, 1840.0, 2480.0), (270.0, 2290.0, 3010.0),
                       (570.0, 840.0, 2410.0), (300.0, 870.0, 2240.0), (660.0, 1720.0, 2410.0)])
_FORMANT_WIDTH_HZ = np.array([80.0, 120.0, 180.0])  # of each formant
_SYLLABLES_HZ = 4.0  # a second

Shape = Callable[[NDArray], NDArray]  # times (s, (k,)) -> pressures of any level (k,)


@dataclass(frozen=True)
class EngineSignal:
    """A piston engine and its tyres or tracks: harmonics of the firing rate, half orders, and noise.

    Parameters:
        firing_hz (Hz): ignitions a second: speed times half the cylinders.
        level_db_spl (dB SPL): level at 1 m.
        revving: relative RMS variation of the speed.
        noise: share of the power that is noise of the tyres.
    """

    firing_hz: float = bounded(70.0, above=0.0, high=500.0)
    level_db_spl: float = bounded(90.0, low=-100.0, high=200.0)
    revving: float = bounded(0.1, low=0.0, high=0.5)
    noise: float = bounded(0.5, low=0.0, high=1.0)

    def stream(self, sample_rate: int, key: Sequence[int], position: Position) -> Stream:
        """See SourceSignal."""
        speed = Wander([*key, 0], 0.5)
        phases = np.random.default_rng([*key, 1]).random(40)
        orders = 0.5 * np.arange(1, 41)
        levels = orders ** -0.7 * np.where(orders % 1.0 == 0.0, 1.0, 0.2)

        def tone(times: NDArray) -> NDArray:
            turns = self.firing_hz * (times + self.revving * speed.integral(times)[:, 0])
            audible = orders * self.firing_hz * (1.0 + 3.0 * self.revving) < 0.45 * sample_rate
            return _harmonics(turns, orders[audible], levels[audible], phases[audible])

        return _mixed(sample_rate, [*key, 2], tone, self.level_db_spl, self.noise, (100.0, 2500.0))


@dataclass(frozen=True)
class HelicopterSignal:
    """Slaps of the main rotor, lines of the tail rotor, the turbine, and noise that the blades modulate.

    Parameters:
        main_hz (Hz): blade passing frequency of the main rotor.
        tail_hz (Hz): blade passing frequency of the tail rotor.
        level_db_spl (dB SPL): level at 1 m.
        noise: share of the power that is noise.
    """

    main_hz: float = bounded(17.0, above=0.0, high=60.0)
    tail_hz: float = bounded(95.0, above=0.0, high=300.0)
    level_db_spl: float = bounded(110.0, low=-100.0, high=200.0)
    noise: float = bounded(0.5, low=0.0, high=1.0)

    def stream(self, sample_rate: int, key: Sequence[int], position: Position) -> Stream:
        """See SourceSignal."""
        phases = np.random.default_rng([*key, 1]).random(24)
        orders = np.arange(1.0, 13.0)

        def slap(times: NDArray) -> NDArray:
            return np.exp(12.0 * (np.cos(2.0 * np.pi * self.main_hz * times) - 1.0))

        def tone(times: NDArray) -> NDArray:
            edge = np.sin(2.0 * np.pi * self.main_hz * times) * slap(times)
            tail = _harmonics(self.tail_hz * times, orders, 0.15 / orders, phases[:12])
            return edge + tail + 0.03 * np.sin(2.0 * np.pi * min(3800.0, 0.4 * sample_rate) * times)

        return _mixed(sample_rate, [*key, 2], tone, self.level_db_spl, self.noise, (60.0, 2000.0),
                      lambda times: 0.15 + slap(times))


@dataclass(frozen=True)
class SirenSignal:
    """A siren or alarm: a tone with harmonics that is swept, or steps between two pitches.

    Parameters:
        low_hz, high_hz (Hz): lowest and highest pitch.
        rate_hz (Hz): sweeps or steps a second.
        steps: whether the pitch steps.
        level_db_spl (dB SPL): level at 1 m.
    """

    low_hz: float = bounded(600.0, above=0.0, high=5000.0)
    high_hz: float = bounded(1400.0, above=0.0, high=5000.0)
    rate_hz: float = bounded(0.4, above=0.0, high=20.0)
    steps: bool = False
    level_db_spl: float = bounded(100.0, low=-100.0, high=200.0)

    def __post_init__(self) -> None:
        if not self.low_hz <= self.high_hz:
            raise ValueError(f'low_hz is {self.low_hz:g}, expected at most high_hz ({self.high_hz:g})')

    def stream(self, sample_rate: int, key: Sequence[int], position: Position) -> Stream:
        """See SourceSignal."""
        middle, half, rate = 0.5 * (self.low_hz + self.high_hz), 0.5 * (self.high_hz - self.low_hz), self.rate_hz
        orders = np.arange(1.0, 6.0)[np.arange(1.0, 6.0) * self.high_hz < 0.45 * sample_rate]

        def tone(times: NDArray) -> NDArray:
            cycle = (rate * times) % 1.0
            swing = (np.abs(cycle - 0.5) - 0.5) / rate if self.steps else -np.cos(2.0 * np.pi * cycle) / (2.0 * np.pi * rate)
            return _harmonics(middle * times + half * swing, orders, orders ** -1.0, np.zeros(len(orders)))

        return _mixed(sample_rate, [*key, 2], tone, self.level_db_spl, 0.0, (200.0, 4000.0))


@dataclass(frozen=True)
class VoiceSignal:
    """A talker: glottal pulses through the formants of changing vowels, syllables, pauses and hissing consonants.

    Parameters:
        pitch_hz (Hz): mean pitch.
        level_db_spl (dB SPL): level at 1 m.
    """

    pitch_hz: float = bounded(120.0, low=50.0, high=500.0)
    level_db_spl: float = bounded(68.0, low=-100.0, high=200.0)

    def stream(self, sample_rate: int, key: Sequence[int], position: Position) -> Stream:
        """See SourceSignal."""
        melody = Wander([*key, 0], 1.5)
        orders = np.arange(1.0, np.floor(min(4500.0, 0.4 * sample_rate) / (1.5 * self.pitch_hz)) + 1.0)
        draws = np.random.default_rng([*key, 1])
        vowels, loud, voiced = draws.integers(0, len(_VOWELS_HZ), 997), draws.random(997) < 0.8, draws.random(997) < 0.8
        frequencies = orders * self.pitch_hz

        def tone(times: NDArray) -> NDArray:
            turns = self.pitch_hz * (times + 0.15 * melody.integral(times)[:, 0])
            syllable = np.floor(_SYLLABLES_HZ * times).astype(int)
            total = np.zeros(len(times))
            for number in np.unique(syllable):
                inside, place = syllable == number, number % 997
                apart = (frequencies[:, None] - _VOWELS_HZ[vowels[place]]) / _FORMANT_WIDTH_HZ
                levels = orders ** -0.8 * (1.0 / (1.0 + apart**2)).sum(axis=1) * (loud[place] and voiced[place])
                total[inside] = _harmonics(turns[inside], orders, levels, np.zeros(len(orders)))
            return total * opening(times)

        def opening(times: NDArray) -> NDArray:
            return np.sin(np.pi * ((_SYLLABLES_HZ * times) % 1.0)) ** 2

        def hiss(times: NDArray) -> NDArray:
            place = np.floor(_SYLLABLES_HZ * times).astype(int) % 997
            return opening(times) * (loud[place] & ~voiced[place])

        return _mixed(sample_rate, [*key, 2], tone, self.level_db_spl, 0.1, (2500.0, 7000.0), hiss)


def _harmonics(turns: NDArray, orders: NDArray, levels: NDArray, phases: NDArray) -> NDArray:
    """Sum of sines (n,) at the orders (h,) of turns (n,), of levels (h,) and phases (h,) in turns."""
    total = np.zeros(len(turns))
    for order, level, phase in zip(orders, levels, phases, strict=True):
        if level:
            total += level * np.sin(2.0 * np.pi * ((order * turns + phase) % 1.0))
    return total


def _mixed(sample_rate: int, key: Sequence[int], tone: Shape, level_db_spl: float, noise: float,
           band_hz: tuple[float, float], swell: Shape | None = None) -> Stream:
    """A tone and noise of a share of the power, together at a level.

    Parameters:
        sample_rate (Hz): sample rate.
        key: seed of the noise.
        tone: the tone at any level.
        level_db_spl (dB SPL): mean level of the start.
        noise: share 0..1 of the power.
        band_hz (Hz): band of the noise.
        swell: amplitude of the noise over time; steady where None.
    """
    taps = firwin(255, [band_hz[0], min(band_hz[1], 0.45 * sample_rate)], pass_zero=False, fs=sample_rate)
    hiss = filtered(white_noise(key), taps / np.sqrt(np.sum(taps**2)))
    start = np.arange(int(LEVEL_S * sample_rate)) / sample_rate
    swelling = swell or np.ones_like
    tone_rms, swell_rms = (max(float(np.sqrt(np.mean(shape(start) ** 2))), 1e-9) for shape in (tone, swelling))
    tone_gain = spl_to_pascal(level_db_spl) * np.sqrt(1.0 - noise) / tone_rms
    noise_gain = spl_to_pascal(level_db_spl) * np.sqrt(noise) / swell_rms

    def make(index: int) -> NDArray:
        times = np.arange(index * CHUNK, (index + 1) * CHUNK) / sample_rate
        total = tone_gain * tone(times)
        return total + noise_gain * swelling(times) * hiss.read(index * CHUNK, (index + 1) * CHUNK) if noise else total

    return Stream(make, SIGNAL_CHUNKS)
