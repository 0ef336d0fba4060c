"""Late reverberation in zones of the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, rfft

from av_common.config_reader import bounded
from av_simulator.sound.delays import AFTER, BEFORE, BlockGrid, along_block, interpolate, kernels, retarded_delay
from av_simulator.sound.fields import diffuse, field_noise
from av_simulator.sound.medium import Medium
from av_simulator.sound.source import Source
from av_simulator.sound.stream import Stream, db_to_ratio

NARROWEST = 0.1  # m, least extent of a zone or a room
_PRE_DELAY_S = 0.02  # s, start of the late reverberation; earlier reflections are computed as rays
_ALIKE_M = 0.1  # m, correlation length of the response along the motion, that of a diffuse field at 1 kHz
# Further pairs of responses, given to the parts by their energy. A single pair for each part leaves a pattern of directions
# that no motion changes, with up to 7 % of the energy: as much as a drone's direct sound in a hall.
_FURTHER_PAIRS = 100
_EDGE_M = 1.0  # m from a zone's box over which its reverberation fades in


@dataclass(frozen=True)
class ReverbZone:
    """A box with late reverberation, which is active if source or rig is inside.

    If only one of them is inside, the reverberation falls as 1/r with the other's distance from the box.

    Parameters:
        minimum, maximum (m, ENU): corners of the box.
        decay_s (s): reverberation time T60 without absorption by air.
        gain_db (dB): energy of the reverberation over that of the direct sound at 1 m; None for Sabine's formula.
        density (1/s): number of separate echoes.
        diffusion (0 to 1): share of the energy in the diffuse part instead of echoes.
    """

    minimum: Sequence[float] = bounded(low=-1e4, high=1e4, longest=3)
    maximum: Sequence[float] = bounded(low=-1e4, high=1e4, longest=3)
    decay_s: float = bounded(1.0, low=0.05, high=20.0)
    gain_db: float | None = bounded(None, low=-200.0, high=200.0)
    density: float = bounded(2000.0, low=1.0, high=1e5)
    diffusion: float = bounded(0.7, low=0.0, high=1.0)

    def __post_init__(self) -> None:
        if not len(self.minimum) == len(self.maximum) == 3 or np.subtract(self.maximum, self.minimum).min() < NARROWEST:
            raise ValueError(f'zone minimum is {list(self.minimum)} and maximum {list(self.maximum)}, '
                             f'expected x, y, z, minimum < maximum by at least {NARROWEST} m')

    def gain(self) -> float:
        """Amplitude ratio of `gain_db`. Sabine: 16 pi / A at 1 m, with the absorption area A = 0.161 V / T."""
        if self.gain_db is not None:
            return 10.0 ** (self.gain_db / 20.0)
        volume = float(np.prod(np.subtract(self.maximum, self.minimum)))
        return float(np.sqrt(16.0 * np.pi * self.decay_s / (0.161 * volume)))

    def weight(self, sources: NDArray, listeners: NDArray) -> NDArray:
        """Amplitude factor (...,) of the reverberation.

        Parameters:
            sources, listeners (m, (..., 3)): positions of source and rig in ENU.
        """
        gaps = np.array([self._outside(sources), self._outside(listeners)])
        inside = np.clip(1.0 - gaps.min(axis=0) / _EDGE_M, 0.0, 1.0)
        return inside / np.maximum(gaps.max(axis=0), 1.0)

    def _outside(self, places: NDArray) -> NDArray:
        """Distance (m, (...,)) from the box, 0 inside."""
        return np.linalg.norm(np.maximum(np.maximum(np.subtract(self.minimum, places), places - self.maximum), 0.0), axis=-1)


class Reverberation:
    """Reverberation of all zones at the microphones.

    The response changes with the positions of source and microphones: with one response for all positions, a steady tone
    would always arrive from the same direction.

    Parameters:
        zones: zones with reverberation.
        sample_rate (Hz): nominal sample rate of the microphones.
        clock_ratio: true interval between samples over the nominal interval.
        sources: all sources.
        signals: emitted signal of each source.
        medium: the air.
        layout (m, (m, 3)): positions of the microphones relative to each other.
        key: seed.
    """

    def __init__(self, zones: Sequence[ReverbZone], sample_rate: int, clock_ratio: float, sources: Sequence[Source],
                 signals: Sequence[Stream], medium: Medium, layout: NDArray, key: Sequence[int]):
        self._zones, self._rate, self._ratio = list(zones), sample_rate, clock_ratio
        self._sources, self._signals, self._medium = list(sources), list(signals), medium
        block = 2 ** round(np.log2(_PRE_DELAY_S / 2.0 * sample_rate))
        answers = [Answer.of(zone, sample_rate, medium, layout, block, [*key, number]) for number, zone in enumerate(zones)]
        self._convolutions = [[MovingConvolution(answer) for answer in answers] for _ in self._sources]

    def render(self, start: int, samples: int, positions: NDArray) -> NDArray:
        """Pressure (Pa, (m, samples)) in one block; the parameters are those of `Propagation.render`."""
        centre = positions.mean(axis=1, keepdims=True)
        grid = BlockGrid(start, samples)
        listener = along_block(centre, start, samples, grid.instants)[0]
        microphones = along_block(positions, start, samples, grid.instants)
        times = (grid.instants * (self._ratio / self._rate)).ravel()
        pressure = np.zeros((len(microphones), samples))
        for source, signal, convolutions in zip(self._sources, self._signals, self._convolutions, strict=True):
            delay = retarded_delay(source.position, listener.reshape(-1, 3), times, self._medium.speed_of_sound)
            place = source.position(times - delay).reshape(listener.shape)
            sent_at = grid.samples * self._ratio - grid.to_samples(delay.reshape(listener.shape[:-1])) * self._rate
            first = int(np.floor(sent_at.min())) - BEFORE - 1
            sent = signal.read(first, int(sent_at.max()) + AFTER + 3)
            received = db_to_ratio(source.gain_db) * interpolate(sent[None], np.zeros(samples, int), sent_at - first)
            ways = np.moveaxis(np.concatenate([place[None], microphones / np.sqrt(len(microphones))]), -1, 1)
            where = grid.to_samples(ways.reshape(-1, *listener.shape[:-1]))
            for zone, convolution in zip(self._zones, convolutions, strict=True):
                pressure += convolution.process(grid.to_samples(zone.weight(place, listener)) * received, where)
        return pressure


@dataclass(frozen=True)
class Answer:
    """A zone's impulse response in parts. Each part is a mean of mixtures of two responses that depend on the place (m, (d,)).

    The weights of each pair of responses are cosine and sine of a random plane wave (random Fourier features, Rahimi and Recht
    2007), which gives a Gaussian correlation with the length _ALIKE_M.

    Parameters:
        spectra ((m, pairs, 2, frequencies)): spectra of the responses of each pair.
        parts (pairs,): the part of the answer to which each pair belongs.
        turns (rad/m, (pairs, d)): wave vector of each pair.
        phases (rad, (pairs,)): phase of each pair.
        block (samples): length of a part.
    """

    spectra: NDArray
    parts: NDArray[np.int_]
    turns: NDArray
    phases: NDArray
    block: int

    @classmethod
    def of(cls, zone: ReverbZone, sample_rate: int, medium: Medium, layout: NDArray, block: int, key: Sequence[int]) -> Answer:
        """The response of a zone, with d = 3 (1 + m) coordinates of source and m microphones.

        Parameters:
            zone: the zone.
            sample_rate (Hz): sample rate.
            medium: the air.
            layout (m, (m, 3)): positions of the microphones relative to each other.
            block (samples): length of a part.
            key: seed.
        """
        random = np.random.default_rng([*key, 2])
        found: list[tuple[NDArray, NDArray, NDArray, NDArray]] = []
        pairs = np.ones(1, int)
        while (number := len(found)) < pairs.max():
            ways = [[*key, 2 * number + way] for way in range(2)]
            both = np.stack([impulse_response(zone, sample_rate, medium, layout, way) for way in ways], axis=1)
            parts = -(-both.shape[2] // block)
            answer = cls.cut(both, block, random.standard_normal((parts, 3 * (1 + len(layout)))) / _ALIKE_M,
                             random.uniform(0.0, 2.0 * np.pi, parts))
            if not found:
                energy = np.sum(np.abs(answer.spectra) ** 2, axis=(0, 2, 3))
                pairs = 1 + np.round(_FURTHER_PAIRS * energy / energy.sum()).astype(int)
            kept = pairs > number
            scale = np.sqrt(1.0 / pairs[kept]).astype(np.float32)[:, None, None]    # of one of a number of pairs
            found.append((answer.spectra[:, kept] * scale, answer.parts[kept], answer.turns[kept], answer.phases[kept]))
        spectra, of_parts, turns, phases = zip(*found, strict=True)
        return cls(np.concatenate(spectra, axis=1), np.concatenate(of_parts), np.concatenate(turns), np.concatenate(phases),
                   block)

    @classmethod
    def cut(cls, both: NDArray, block: int, turns: NDArray, phases: NDArray) -> Answer:
        """Divide two responses (m, 2, length) into parts of one pair each; the other parameters are those of the class."""
        padded = np.pad(both, ((0, 0), (0, 0), (0, len(turns) * block - both.shape[2])))
        parts = np.moveaxis(padded.reshape(*both.shape[:2], len(turns), block), 1, 2)
        return cls(rfft(parts, 4 * block).astype(np.complex64), np.arange(len(turns)), turns, phases, block)

    def shares(self, place: NDArray) -> NDArray[np.float32]:
        """Weights (pairs, 2) of both responses at a place (m, (d,)); the squares of each pair sum to 1."""
        angles = self.turns @ place + self.phases
        return np.stack([np.cos(angles), np.sin(angles)], axis=1).astype(np.float32)


def impulse_response(zone: ReverbZone, sample_rate: int, medium: Medium, layout: NDArray, key: Sequence[int]) -> NDArray:
    """Impulse response (m, length) of a zone: decaying diffuse noise and echoes, plane waves from random directions.

    Parameters:
        zone: the zone.
        sample_rate (Hz): sample rate.
        medium: the air.
        layout (m, (m, 3)): positions of the microphones relative to each other.
        key: seed.
    """
    length = int(1.1 * zone.decay_s * sample_rate)
    smooth = field_noise([*key, 0], sample_rate, layout, np.ones_like, diffuse(medium.speed_of_sound)).read(0, length)
    random = np.random.default_rng([*key, 1])
    count = random.poisson(zone.density * length / sample_rate)
    directions = random.standard_normal((count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    earlier = (layout - layout.mean(axis=0)) @ directions.T * (sample_rate / medium.speed_of_sound)
    arrivals = np.clip(random.uniform(0.0, length, count) - earlier, BEFORE, length - AFTER - 1)  # (m, count)
    below = np.floor(arrivals).astype(int)
    pulses = random.choice([-1.0, 1.0], count)[:, None] * kernels(arrivals - below)
    echoes = np.zeros_like(smooth)
    for echo, indices, pulse in zip(echoes, below[..., None] + np.arange(-BEFORE, AFTER + 1), pulses, strict=True):
        np.add.at(echo, indices, pulse)
    density_gain = np.sqrt(sample_rate / zone.density)
    answer = np.sqrt(zone.diffusion) * smooth + np.sqrt(1.0 - zone.diffusion) * density_gain * echoes
    answer = _decaying(answer, zone.decay_s, sample_rate, medium)
    return answer * zone.gain() / np.sqrt(np.mean(np.sum(answer**2, axis=1)))


def _decaying(signal: NDArray, decay_s: float, sample_rate: int, medium: Medium) -> NDArray:
    """The signal (m, length) with a decay of 60 dB in `decay_s`, plus the absorption of air at each frequency."""
    size = 2 ** round(np.log2(0.02 * sample_rate))
    hop, length = size // 2, signal.shape[1]
    rate_db = 60.0 / decay_s + medium.speed_of_sound * medium.absorption_db_per_m(np.fft.rfftfreq(size, 1.0 / sample_rate))
    window = np.sin(np.pi * (np.arange(size) + 0.5) / size)
    padded = np.pad(signal, ((0, 0), (hop, 2 * size)))
    decayed = np.zeros_like(padded)
    for begin in range(0, length + hop, hop):
        gain = 10.0 ** (-rate_db * (begin / sample_rate) / 20.0)
        piece = rfft(padded[:, begin:begin + size] * window) * gain
        decayed[:, begin:begin + size] += irfft(piece, size) * window
    return decayed[:, hop:hop + length]


class MovingConvolution:
    """Partitioned convolution (Stockham 1966) with a response that depends on the place, with a delay of two blocks.

    The sound of each block is convolved with the response at its place, with linear cross-fades between blocks.
    """

    def __init__(self, answer: Answer):
        self._answer, self._block = answer, answer.block
        outputs, pairs, _, frequencies = answer.spectra.shape
        parts = int(answer.parts.max()) + 1
        self._each = np.arange(pairs)
        self._inputs = np.zeros((parts, frequencies), np.complex64)  # ring of the last blocks' spectra, newest first
        self._shares = np.zeros((parts, pairs, 2), np.float32)  # weights of each pair at the places of these blocks
        self._filled = self._newest = 0
        rising = (np.arange(self._block) + 0.5) / self._block
        self._window = np.concatenate([rising, rising[::-1]])
        self._input, self._output = np.zeros(2 * self._block), np.zeros((outputs, 3 * self._block))

    def process(self, samples: NDArray, places: NDArray) -> NDArray:
        """The next output (m, n) for input samples (n,) at places (m, (d, n))."""
        output, done = np.empty((len(self._output), len(samples))), 0
        while done < len(samples):
            taken = min(self._block - self._filled, len(samples) - done)
            now = slice(self._filled, self._filled + taken)
            output[:, done:done + taken] = self._output[:, now]
            self._input[self._block:][now] = samples[done:done + taken]
            if self._filled == 0:
                self._place = places[:, done]
            self._filled, done = self._filled + taken, done + taken
            if self._filled == self._block:
                self._turn()
        return output

    def _turn(self) -> None:
        self._newest = (self._newest or len(self._inputs)) - 1
        self._inputs[self._newest] = rfft(self._input * self._window, 4 * self._block)
        self._shares[self._newest] = self._answer.shares(self._place)
        order = (self._newest + self._answer.parts) % len(self._inputs)
        mixed = self._shares[order, self._each][..., None] * self._inputs[order][:, None]
        answer = irfft((self._answer.spectra * mixed).sum(axis=(1, 2)), 4 * self._block)
        self._output = np.pad(self._output[:, self._block:], ((0, 0), (0, self._block)))
        self._output += answer[:, :3 * self._block]
        self._input[:self._block] = self._input[self._block:]
        self._filled = 0
