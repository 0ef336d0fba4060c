"""Rendering of the signals of all microphones of a moving rig."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_simulator.sound.medium import Medium
from av_simulator.sound.noise import Noise, Snr
from av_simulator.sound.propagation import Propagation
from av_simulator.sound.rays import Surroundings
from av_simulator.sound.reverberation import Reverberation
from av_simulator.sound.source import Source
from av_simulator.sound.stream import LEVEL_S, Stream, band_power, db_to_ratio


class SoundWorld:
    """Renders the signal of each microphone, block by block.

    The sound pressure is p(t) = g(r) s(t - r/c), where r is the distance from the source's position at t - r/c to the
    microphone's position at t. This includes Doppler shift, delay and level. The same seed gives the same samples for any
    size of the blocks; with moving microphones, this requires blocks of multiples of 80 samples. Raises ValueError.

    Parameters:
        sample_rate (Hz): sample rate, 8000 or more.
        sources: all sources.
        medium: the air.
        microphones: number of microphones.
        noise: noise at the microphones.
        seed: seed of all random numbers.
        full_scale_pa (Pa): pressure of a sample of 1.
        surroundings: ground, obstacles, room, reverberation.
        clock_ppm (ppm): deviation of the microphones' sample rate; positive for a fast clock.
    """

    def __init__(self, sample_rate: int, sources: Sequence[Source], medium: Medium | None = None, microphones: int = 2,
                 noise: Noise | None = None, seed: int = 0, full_scale_pa: float = 1.0,
                 surroundings: Surroundings | None = None, clock_ppm: float = 0.0):
        if sample_rate < 8000:
            raise ValueError(f'sample_rate is {sample_rate}, expected 8000 Hz or more')
        self._rate, self._sources, self._microphones = sample_rate, list(sources), microphones
        self._medium = medium or Medium()
        self._noise, self._seed, self._full_scale_pa = noise or Noise(), seed, full_scale_pa
        self._clock_rate = sample_rate * (1.0 + clock_ppm * 1e-6)
        self._signals = [source.signal.stream(sample_rate, [seed, 1, number], source.position)
                        for number, source in enumerate(self._sources)]
        surroundings = surroundings or Surroundings()
        self._propagation = Propagation(sample_rate, sample_rate / self._clock_rate, self._sources, self._signals, self._medium,
                                        surroundings)
        self._zones = surroundings.zones
        self._reverberation: Reverberation | None = None
        self._noise_stream: Stream | None = None
        self._noise_gain = 1.0
        self._next, self._level_samples = 0, int(LEVEL_S * sample_rate)    # of a stream from which its level is taken
        snr = self._noise.snr
        self._wanted_noise = 0.0 if snr is None else self._power_of_reference(snr) / 10.0 ** (snr.ratio_db / 10.0)    # Pa^2

    def skip(self, n: int) -> None:
        """Leave out the next `n` samples. What follows is as if they had been rendered, but for 20 ms and for reverberation."""
        self._next += n
        self._propagation.restart()

    def render(self, n: int, microphone_positions: ArrayLike) -> NDArray:
        """The next samples (n, m) of all microphones, float32, full scale 1. Raises ValueError for a wrong shape.

        Parameters:
            n: number of samples.
            microphone_positions (m, (k, m, 3)): positions in ENU at k >= 2 evenly spaced instants from the block's start to
                its end, inclusive. Between them the motion is linear; intervals of 5 ms are short enough for a turning rig.
        """
        positions = np.asarray(microphone_positions, float)
        if positions.ndim != 3 or positions.shape[1:] != (self._microphones, 3) or len(positions) < 2:
            raise ValueError(f'microphone_positions has shape {positions.shape}, '
                             f'expected (k, {self._microphones}, 3) with k >= 2')
        if n < 1:
            raise ValueError(f'n is {n}, expected 1 or more samples')
        start, self._next = self._next, self._next + n
        if self._noise_stream is None:
            self._noise_stream = self._begin(positions[0])
        received = self._propagation.render(start, n, positions)
        received += self._noise_gain * self._noise_stream.read(start, start + n)
        if self._reverberation is not None:
            received += self._reverberation.render(start, n, positions)
        return (received.T / self._full_scale_pa).astype(np.float32)

    def _begin(self, layout: NDArray) -> Stream:
        """Create noise and reverberation for the array's geometry (m, (m, 3)); wind refers to its present orientation."""
        noise = self._noise.stream(self._rate, layout, self._medium.speed_of_sound, [self._seed, 0])
        if self._zones:
            self._reverberation = Reverberation(self._zones, self._rate, self._rate / self._clock_rate, self._sources,
                                                self._signals, self._medium, layout, [self._seed, 2])
        snr = self._noise.snr
        if snr is not None:
            steady = self._noise.steady().stream(self._rate, layout, self._medium.speed_of_sound, [self._seed, 0])
            power = band_power(steady.read(0, self._level_samples), self._rate, snr.band_hz)
            self._noise_gain = float(np.sqrt(self._wanted_noise / power))
        return noise

    def _power_of_reference(self, snr: Snr) -> float:
        """In-band power (Pa^2) at one microphone of the source to which the signal-to-noise ratio refers."""
        if not self._sources:
            raise ValueError('snr is given without a source')
        power = band_power(self._signals[0].read(0, self._level_samples), self._rate, snr.band_hz)
        if power == 0.0:
            raise ValueError(f'snr source is 0, which is silent from {snr.band_hz[0]:g} to {snr.band_hz[1]:g} Hz in its first '
                             'seconds; omit snr and set the levels of the noise in dB SPL')
        return power * (db_to_ratio(self._sources[0].gain_db) / snr.distance_m) ** 2
