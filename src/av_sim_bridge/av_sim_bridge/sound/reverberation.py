"""Late reverberation in zones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, rfft

from av_sim_bridge.sound.delays import BlockGrid, along_block, retarded_delay
from av_sim_bridge.sound.fields import diffuse, field_noise
from av_sim_bridge.sound.interpolation import AFTER, BEFORE, interpolate, kernels
from av_sim_bridge.sound.levels import db_to_ratio
from av_sim_bridge.sound.medium import Medium
from av_sim_bridge.sound.source import Source
from av_sim_bridge.sound.stream import Stream

_PRE_DELAY_S = 0.01
_WAYS = 8  # answers of a zone, which every place mixes in another way
_ALIKE_M = 0.1  # over so much of the way of source or microphones the mixture is alike, as a diffuse field of 1 kHz is


@dataclass(frozen=True)
class ReverbZone:
    """A box of world space that answers sound when the source or the rig is inside.

    `decay_s` is the time of 60 dB below the frequencies that air swallows. `density` is the number of separate echoes
    in a second; `diffusion`, 0 to 1, the share of the energy that is smooth instead. `gain_db` is the energy of all
    reverberation over that of the direct sound at 1 m; by default it follows from Sabine's formula and the zone's
    volume. Within `edge_m` of the box the zone fades in; a partner that stays outside is heard as 1/r of its distance
    to the box.
    """

    minimum: Sequence[float]
    maximum: Sequence[float]
    decay_s: float = 1.0
    gain_db: float | None = None
    density: float = 2000.0
    diffusion: float = 0.7
    edge_m: float = 1.0

    def __post_init__(self) -> None:
        if not np.all(np.less(self.minimum, self.maximum)):
            raise ValueError(f'zone minimum is {list(self.minimum)} and maximum {list(self.maximum)}, '
                             'expected minimum < maximum')
        for name, value, low, high in (('decay_s', self.decay_s, 0.05, 20.0), ('density', self.density, 1.0, 1e5),
                                       ('diffusion', self.diffusion, 0.0, 1.0)):
            if not low <= value <= high:
                raise ValueError(f'zone {name} is {value}, expected {low} to {high}')

    def gain(self) -> float:
        """Amplitude ratio of `gain_db`. Sabine: 16 pi / A at 1 m, with the absorption area A = 0.161 V / T."""
        if self.gain_db is not None:
            return 10.0 ** (self.gain_db / 20.0)
        volume = float(np.prod(np.subtract(self.maximum, self.minimum)))
        return float(np.sqrt(16.0 * np.pi * self.decay_s / (0.161 * volume)))

    def weight(self, sources: NDArray, listeners: NDArray) -> NDArray:
        """Share (...,) of the sound at places (..., 3) that the zone answers."""
        gaps = np.array([self._outside(sources), self._outside(listeners)])
        inside = np.clip(1.0 - gaps.min(axis=0) / self.edge_m, 0.0, 1.0)
        return inside / np.maximum(gaps.max(axis=0), 1.0)

    def _outside(self, places: NDArray) -> NDArray:
        """Distance (...,) from the box, 0 inside."""
        return np.linalg.norm(np.maximum(np.maximum(np.subtract(self.minimum, places), places - self.maximum), 0.0), axis=-1)


class Reverberation:
    """The answer of all zones at microphones with a given layout (m, 3).

    A room answers anew wherever source and microphones are: with one answer for all places, a steady tone would seem to
    come from one and the same direction for ever.
    """

    def __init__(self, zones: Sequence[ReverbZone], sample_rate: int, clock_ratio: float, sources: Sequence[Source],
                 voices: Sequence[Stream], medium: Medium, layout: NDArray, key: Sequence[int]):
        self._zones, self._rate, self._ratio = list(zones), sample_rate, clock_ratio
        self._sources, self._voices, self._medium = list(sources), list(voices), medium
        block = 2 ** round(np.log2(_PRE_DELAY_S * sample_rate))
        self._answers = [Convolution(np.stack([impulse_response(zone, sample_rate, medium, layout, [*key, number, way])
                                               for way in range(_WAYS)], axis=1), block) for number, zone in enumerate(zones)]
        self._mixture = Mixture(len(layout), key)

    def render(self, start: int, samples: int, positions: NDArray) -> NDArray:
        """Pressure (m, samples) in Pa during a block heard at positions (k, m, 3)."""
        centre = positions.mean(axis=1, keepdims=True)
        grid = BlockGrid(start, samples, moving=bool(np.any(centre != centre[0])))
        listener = along_block(centre, start, samples, grid.instants)[0]
        microphones = along_block(positions, start, samples, grid.instants)
        times = (grid.instants * (self._ratio / self._rate)).ravel()
        fed = np.zeros((len(self._zones), _WAYS, samples))
        for source, voice in zip(self._sources, self._voices, strict=True):
            delay = retarded_delay(source.position, listener.reshape(-1, 3), times, self._medium.speed_of_sound)
            place = source.position(times - delay).reshape(listener.shape)
            sent_at = grid.samples * self._ratio - grid.to_samples(delay.reshape(listener.shape[:-1])) * self._rate
            first = int(np.floor(sent_at.min())) - BEFORE - 1
            sent = voice.read(first, int(sent_at.max()) + AFTER + 3)
            heard = db_to_ratio(source.gain_db) * interpolate(sent[None], np.zeros(samples, int), sent_at - first)
            mixed = heard * grid.to_samples(self._mixture.at(place, microphones))
            for feed, zone in zip(fed, self._zones, strict=True):
                feed += grid.to_samples(zone.weight(place, listener)) * mixed
        return sum(answer.process(feed) for answer, feed in zip(self._answers, fed, strict=True))


class Mixture:
    """How much of each of a zone's answers is heard, by place: unit vectors, alike over _ALIKE_M of way (Gaussian correlation).

    Random Fourier features (Rahimi and Recht, 2007): sines and cosines of random plane waves over all coordinates.
    """

    def __init__(self, microphones: int, key: Sequence[int]):
        random = np.random.default_rng([*key, 2])
        self._phases = random.uniform(0.0, 2.0 * np.pi, _WAYS // 2)
        self._of_source = random.standard_normal((_WAYS // 2, 3)) / _ALIKE_M
        self._of_microphones = random.standard_normal((_WAYS // 2, microphones, 3)) / (_ALIKE_M * np.sqrt(microphones))

    def at(self, source: NDArray, microphones: NDArray) -> NDArray:
        """Shares (ways, ...) with the source at (..., 3) and the microphones at (m, ..., 3)."""
        angles = (np.einsum('wi,...i->w...', self._of_source, source)
                  + np.einsum('wmi,m...i->w...', self._of_microphones, microphones))
        angles += self._phases.reshape(-1, *([1] * (angles.ndim - 1)))
        return np.concatenate([np.cos(angles), np.sin(angles)]) / np.sqrt(_WAYS // 2)


def impulse_response(zone: ReverbZone, sample_rate: int, medium: Medium, layout: NDArray, key: Sequence[int]) -> NDArray:
    """The zone's answer (m, length) to a pulse.

    It is diffuse noise plus echoes, which are plane waves from random directions; both decay.
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
    """The signal (m, length) decaying by 60 dB in `decay_s`, and faster where the air absorbs (both rates add)."""
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


class Convolution:
    """Convolution of i signals with long impulse responses (m, i, length) in equal parts (Stockham 1966), and their sum.

    It comes later by one `block` of samples.
    """

    def __init__(self, response: NDArray, block: int):
        outputs, inputs, length = response.shape
        parts = -(-length // block)
        padded = np.pad(response, ((0, 0), (0, 0), (0, parts * block - length))).reshape(outputs, inputs, parts, block)
        self._response = np.moveaxis(rfft(padded, 2 * block), 2, 1)  # (m, parts, i, frequencies)
        self._heard = np.zeros((parts, inputs, block + 1), complex)  # ring of the last blocks' spectra, older ones further on
        self._block, self._filled, self._newest = block, 0, 0
        self._input, self._output = np.zeros((inputs, 2 * block)), np.zeros((outputs, block))

    def process(self, samples: NDArray) -> NDArray:
        """The next samples (i, n) to the next output (m, n)."""
        count, done = samples.shape[1], 0
        output = np.empty((len(self._output), count))
        while done < count:
            taken = min(self._block - self._filled, count - done)
            now = slice(self._filled, self._filled + taken)
            output[:, done:done + taken] = self._output[:, now]
            self._input[:, self._block:][:, now] = samples[:, done:done + taken]
            self._filled, done = self._filled + taken, done + taken
            if self._filled == self._block:
                self._turn()
        return output

    def _turn(self) -> None:
        self._newest = (self._newest or len(self._heard)) - 1
        self._heard[self._newest] = rfft(self._input)
        fresh = len(self._heard) - self._newest  # parts before the ring's end
        answer = np.einsum('mpif,pif->mf', self._response[:, :fresh], self._heard[self._newest:])
        answer += np.einsum('mpif,pif->mf', self._response[:, fresh:], self._heard[:self._newest])
        self._output = irfft(answer, 2 * self._block)[:, self._block:]
        self._input[:, :self._block] = self._input[:, self._block:]
        self._filled = 0
