"""Propagation of sound from moving sources to moving microphones along all rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal.windows import tukey

from av_simulator.sound.delays import BEFORE, TAPS, BlockGrid, along_block, interpolate, retarded_delay
from av_simulator.sound.medium import Medium
from av_simulator.sound.rays import Surroundings, rays_of
from av_simulator.sound.source import Source
from av_simulator.sound.stream import Stream, db_to_ratio

FASTEST = 0.4  # maximum speed of approach between source and microphones, relative to the speed of sound
NEAREST = 0.1  # m, distance below which a source becomes no louder
_FRAME_S = 0.02  # length of a frame, in which filters are constant


@dataclass(frozen=True)
class Frame:
    """Signals along each ray for one frame of reception, filtered by the frequency response of the ray.

    Parameters:
        signals ((sources, rays, length)): samples at the emission.
        first ((sources, rays)): index of the first emitted sample.
        active ((sources, rays), bool): rays that carry sound.
    """

    signals: NDArray
    first: NDArray
    active: NDArray


class FrameMaker:
    """Filters signals by finite impulse responses, which are cross-faded between consecutive frames.

    Parameters:
        sample_rate (Hz): sample rate.
        signals: emitted signal of each source.
    """

    def __init__(self, sample_rate: int, signals: Sequence[Stream]):
        self._signals = list(signals)
        self.samples = 2 ** round(np.log2(_FRAME_S * sample_rate))
        self._half = self.samples // 4
        self._taper = tukey(2 * self._half, 0.5, sym=False)
        self.frequency_hz = np.fft.rfftfreq(2 * self._half, 1.0 / sample_rate)
        self._before: tuple[NDArray, NDArray] | None = None

    def make(self, sent: NDArray, factors: NDArray, spread: int) -> Frame:
        """The signals of one frame.

        Parameters:
            sent (samples, (sources, rays)): time of emission of the sound that the array's centre receives at the start.
            factors ((sources, rays, F)): responses of the rays at `frequency_hz`.
            spread (samples): maximum difference of the delays between a microphone and the array's centre.
        """
        first = np.floor(sent).astype(int) - spread - BEFORE - 2
        length = int(self.samples / (1.0 - FASTEST)) + 2 * spread + TAPS + 4    # sources that approach are compressed (Doppler)
        sent_before, factors_before = self._before or (sent - self.samples, factors)
        self._before = sent, factors
        active = np.any(factors, axis=-1) | np.any(factors_before, axis=-1)
        signals = np.zeros((*sent.shape, length))
        size = next_fast_len(length + 2 * self._half, real=True)
        for number, rays in enumerate(active):
            if not rays.any():
                continue
            spectrum = rfft(self._read(number, first[number, rays] - self._half, length + 2 * self._half), size)
            old, new = (irfft(spectrum * self._response(f[number, rays], size), size)[:, 2 * self._half:2 * self._half + length]
                        for f in (factors_before, factors))
            since = first[number, rays, None] + np.arange(length) - sent[number, rays, None]
            share = np.clip(since / (sent - sent_before)[number, rays, None], 0.0, 1.0)
            signals[number, rays] = old + share * (new - old)
        return Frame(signals, first, active)

    def _response(self, factors: NDArray, size: int) -> NDArray:
        """Spectrum of `size` points of the impulse responses, whose middle tap is `_half`, of factors (rays, F)."""
        taps = np.roll(irfft(factors, 2 * self._half), self._half, axis=-1) * self._taper
        return rfft(taps, size)

    def _read(self, number: int, begins: NDArray, length: int) -> NDArray:
        """Parts (len(begins), length) of the signal of a source, which start at several samples."""
        low = int(begins.min())
        samples = self._signals[number].read(low, int(begins.max()) + length)
        return samples[(begins - low)[:, None] + np.arange(length)]


class Propagation:
    """The sum of the sound of all sources along all rays.

    Delay and spreading are computed for each microphone and sample. Frequency-dependent effects (air, ground, faces, edges,
    directivity) are computed for the array's centre at the start of each frame of about 20 ms.

    Parameters:
        sample_rate (Hz): nominal sample rate of the microphones.
        clock_ratio: true interval between samples over the nominal interval.
        sources: all sources.
        signals: emitted signal of each source.
        medium: the air.
        surroundings: ground, obstacles and room.
    """

    def __init__(self, sample_rate: int, clock_ratio: float, sources: Sequence[Source], signals: Sequence[Stream],
                 medium: Medium, surroundings: Surroundings):
        self._rate, self._ratio = sample_rate, clock_ratio
        self._sources, self._medium = list(sources), medium
        self._signals, self._maker = signals, FrameMaker(sample_rate, signals)
        frequency = self._maker.frequency_hz
        self._air = medium.absorption_db_per_m(frequency) if medium.absorption else np.zeros(len(frequency))
        self._rays = rays_of(surroundings, frequency, medium.speed_of_sound)
        self._mirrors = np.array([ray.mirror for ray in self._rays])
        self._shifts = np.array([ray.shift for ray in self._rays])
        self._frames: dict[int, Frame] = {}
        self._spread = 0

    def restart(self) -> None:
        """Render next a block that does not follow the one before."""
        self._frames.clear()
        self._maker = FrameMaker(self._rate, self._signals)

    def render(self, start: int, samples: int, positions: NDArray) -> NDArray:
        """Pressure (Pa, (m, samples)) in one block.

        Parameters:
            start: index of the first sample of the block.
            samples: number of samples.
            positions (m, (k, m, 3)): microphones in ENU at k evenly spaced instants from the block's start to its end.
        """
        self._begin_frames(start, samples, positions)
        grid = BlockGrid(start, samples)
        receivers = along_block(positions, start, samples, grid.instants)
        received = np.zeros((positions.shape[1], samples))
        for number in range(len(self._sources)):
            received += self._receive(number, grid, receivers)
        return received

    def _receive(self, number: int, grid: BlockGrid, receivers: NDArray) -> NDArray:
        """Pressure (Pa, (m, samples)) of one source at receivers (m, (m, intervals, 4, 3))."""
        first_frame = grid.samples[0] // self._maker.samples
        frame_of = grid.samples // self._maker.samples - first_frame
        frames = [self._frames[first_frame + index] for index in range(frame_of[-1] + 1)]
        rays = np.flatnonzero(np.any([frame.active[number] for frame in frames], axis=0))
        if len(rays) == 0:
            return np.zeros((len(receivers), len(grid.samples)))
        images = np.einsum('rij,m...j->rm...i', self._mirrors[rays], receivers) + self._shifts[rays][:, None, None, None]
        times = (grid.instants * (self._ratio / self._rate)).ravel()
        c = self._medium.speed_of_sound
        delay = retarded_delay(self._sources[number].position, images.reshape(*images.shape[:2], -1, 3), times, c)
        delay = delay.reshape(images.shape[:-1])
        signals = np.array([frame.signals[number, rays] for frame in frames])  # (frames, rays, length)
        begins = np.array([frame.first[number, rays] for frame in frames])
        places = grid.samples * self._ratio - grid.to_samples(delay) * self._rate - begins[frame_of].T[:, None]
        rows = np.broadcast_to((frame_of * len(rays) + np.arange(len(rays))[:, None])[:, None], places.shape)
        try:
            values = interpolate(signals.reshape(-1, signals.shape[-1]), rows, places)
        except ValueError as error:
            when = grid.samples[0] / self._rate
            raise ValueError(f'source {number} or the rig jumps, or is faster than {FASTEST} of the speed of sound, '
                             f'near {when:.2f} s') from error
        gain = db_to_ratio(self._sources[number].gain_db) * grid.to_samples(1.0 / np.maximum(delay * c, NEAREST))
        return np.einsum('rmn,rmn->mn', gain, values)

    def _begin_frames(self, start: int, samples: int, positions: NDArray) -> None:
        """Compute the frames that start within a block, and discard those that ended before it."""
        length = self._maker.samples
        self._frames = {index: frame for index, frame in self._frames.items() if (index + 1) * length > start}
        first = -(-start // length)
        if not self._frames:
            first = start // length
            apart = np.linalg.norm(positions[0] - positions[0].mean(axis=0), axis=-1).max()
            self._spread = int(1.1 * apart / self._medium.speed_of_sound * self._rate) + 2
        for index in range(first, (start + samples - 1) // length + 1):
            microphones = along_block(positions, start, samples, np.array([float(index * length)]))[:, 0]
            self._frames[index] = self._frame(index * length * self._ratio, microphones.mean(axis=0))

    def _frame(self, received_at: float, centre: NDArray) -> Frame:
        """The frame that the array's centre (m, (3,)) receives from `received_at` (samples of true time)."""
        images = self._mirrors @ centre + self._shifts
        sent = np.empty((len(self._sources), len(images)))
        factors = np.zeros((*sent.shape, len(self._air)), complex)
        for number, source in enumerate(self._sources):
            now = np.array([received_at / self._rate])
            delay = retarded_delay(source.position, images[:, None], now, self._medium.speed_of_sound)[:, 0]
            sent[number] = received_at - delay * self._rate
            factors[number] = self._factors(source, sent[number] / self._rate, images, centre)
        return self._maker.make(sent, factors, self._spread)

    def _factors(self, source: Source, sent_s: NDArray, images: NDArray, centre: NDArray) -> NDArray:
        """Responses (rays, F) from a source at times of emission (s, (rays,)) to the images (m, (rays, 3)) of the centre."""
        places = source.position(sent_s)
        ways = images - places
        distance = np.linalg.norm(ways, axis=1, keepdims=True)
        factors = 10.0 ** (-self._air * distance / 20.0) * (1.0 + 0.0j)
        if source.directivity is not None:
            factors *= source.directivity(ways / np.maximum(distance, 1e-9), self._maker.frequency_hz)
        for factor, ray in zip(factors, self._rays, strict=True):
            on_the_way = ray.factor(places[0], centre)
            factor *= 0.0 if on_the_way is None else on_the_way
        return factors
