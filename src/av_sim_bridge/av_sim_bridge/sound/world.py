"""What the microphones of a moving rig hear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_sim_bridge.sound.delays import BlockGrid, Position, along_block, retarded_delay
from av_sim_bridge.sound.interpolation import AFTER, BEFORE, interpolate
from av_sim_bridge.sound.levels import db_to_ratio
from av_sim_bridge.sound.medium import Medium
from av_sim_bridge.sound.noise import Noise
from av_sim_bridge.sound.stream import Stream, band_power
from av_sim_bridge.sound.voices import Voice


@dataclass(frozen=True)
class Source:
    """A point that sounds. `position` gives world ENU positions (k, 3) in m at times (k,) in s, before time 0 as well."""

    position: Position
    voice: Voice
    gain_db: float = 0.0


class SoundWorld:
    """Renders what each microphone hears, block by block.

    The sound pressure is p(t) = g(r) s(t - r/c), where r is the distance from where the source was at t - r/c to where the
    microphone is at t. Doppler, delays and levels follow from it. The same seed gives the same samples, however time is cut into blocks.
    """

    def __init__(self, sample_rate: int, sources: Sequence[Source], medium: Medium | None = None, microphones: int = 2,
                 noise: Noise | None = None, seed: int = 0, full_scale_pa: float = 1.0):
        """`full_scale_pa` is the pressure that gives a sample of 1."""
        self._rate = sample_rate
        self._sources = list(sources)
        self._medium = medium or Medium()
        self._microphones = microphones
        self._full_scale_pa = full_scale_pa
        self._next = 0
        self._signals = [source.voice.stream(sample_rate, [seed, 1, number], source.position)
                         for number, source in enumerate(self._sources)]
        self._noise = (noise or Noise()).stream(sample_rate, microphones, [seed, 0])
        self._noise_gain = self._gain_for(noise)

    @property
    def next_sample(self) -> int:
        """Index of the first sample that the next call of `render` gives; sample 0 is at time 0."""
        return self._next

    def render(self, n: int, microphone_positions: ArrayLike) -> NDArray:
        """The next `n` samples of all microphones, (n, m) float32, where 1 is full scale.

        microphone_positions (k, m, 3): world ENU in m at k >= 2 instants evenly spaced from the block's start to its end
        inclusive; between them microphones move in straight lines (5 ms or less between instants keeps a turning rig exact).
        Raises ValueError when the shape is wrong.
        """
        positions = np.asarray(microphone_positions, float)
        if positions.ndim != 3 or positions.shape[1:] != (self._microphones, 3) or len(positions) < 2:
            raise ValueError(f'microphone_positions has shape {positions.shape}, expected (k, {self._microphones}, 3) with k >= 2')
        if n < 1:
            raise ValueError(f'n is {n}, expected 1 or more samples')
        start, self._next = self._next, self._next + n
        grid = BlockGrid(start, n, moving=bool(np.any(positions != positions[0])))
        receivers = along_block(positions, start, n, grid.instants)
        heard = self._noise_gain * self._noise.read(start, start + n)
        for source, signal in zip(self._sources, self._signals):
            heard = heard + db_to_ratio(source.gain_db) * self._propagate(source, signal, grid, receivers, start)
        return (heard.T / self._full_scale_pa).astype(np.float32)

    def _propagate(self, source: Source, signal: Stream, grid: BlockGrid, receivers: NDArray, start: int) -> NDArray:
        """Pressure (m, n) of one source at the receivers (m, intervals, 4, 3)."""
        shape = receivers.shape[:-1]
        times = np.broadcast_to(grid.instants / self._rate, shape).reshape(len(receivers), -1)
        delay = retarded_delay(source.position, receivers.reshape(*times.shape, 3), times[0], self._medium.speed_of_sound).reshape(shape)
        gain = grid.to_samples(self._medium.attenuation(delay * self._medium.speed_of_sound))
        places = grid.samples - grid.to_samples(delay) * self._rate
        first = int(np.floor(places.min())) - BEFORE
        heard = signal.read(first, int(np.floor(places.max())) + AFTER + 2)
        return gain * interpolate(heard[None], places[None] - first)[0]

    def _gain_for(self, noise: Noise | None) -> float:
        """Factor on the noise that gives the wanted ratio to the reference source."""
        if noise is None or noise.snr is None:
            return 1.0
        snr = noise.snr
        if not 0 <= snr.source < len(self._sources):
            raise ValueError(f'snr source is {snr.source}, expected 0 to {len(self._sources) - 1}')
        at_reference = float(self._medium.attenuation(np.array([snr.distance_m]))[0]) * db_to_ratio(self._sources[snr.source].gain_db)
        wanted = band_power(self._signals[snr.source], self._rate, snr.band_hz) * at_reference**2 / 10.0 ** (snr.ratio_db / 10.0)
        return float(np.sqrt(wanted / band_power(self._noise, self._rate, snr.band_hz)))
