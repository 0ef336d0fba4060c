"""Examples: one second of a scene as a pair or array hears it, and the features of the sound from one direction."""

from __future__ import annotations

import numpy as np
from material import RATE, SPEED_OF_SOUND
from numpy.typing import NDArray
from rooms import room

from av_audio.drone_classifier import SourceSpectra
from av_audio.drone_features import FRAME_S, HOP_S, SEGMENT_FRAMES, DroneFeatures
from av_common.microphone_array import MicrophoneArray

SAMPLES = round((FRAME_S + (SEGMENT_FRAMES - 1) * HOP_S) * RATE)
IN_ROOM = 0.45, 0.2  # share of the scenes; of those whose sounds keep their colour
ROOMS = 100  # of each array


class Scenes:
    """Makes features of random scenes: spacing, direction, colour of microphone and air, echoes, noise, a second source.

    Parameters:
        rng: source of all random numbers.
        as_recorded: share of the sounds that keep their colour, without added echoes.
    """

    def __init__(self, rng: np.random.Generator, as_recorded: float = 0.0) -> None:
        self._rng, self._as_recorded = rng, as_recorded
        self._features = DroneFeatures()
        pairs = [MicrophoneArray(np.array([[0.0, d / 2, 0.0], [0.0, -d / 2, 0.0]]), f'pair_{k}')
                 for k, d in enumerate((0.08, 0.12, 0.16, 0.2, 0.25, 0.3))]
        square = MicrophoneArray(np.array([[x, y, 0.0] for x in (-0.033, 0.033) for y in (-0.033, 0.033)]), 'square')
        wide = MicrophoneArray(np.array([[x, y, 0.0] for x in (-0.06, 0.06) for y in (-0.06, 0.06)]), 'wide')
        arrays = (*pairs, square, wide)
        self._arrays = [(array, SourceSpectra(array, RATE, SPEED_OF_SOUND), [room(array, rng) for _ in range(ROOMS)])
                        for array in arrays]

    def example(self, source: NDArray, other: NDArray | None, snr_db: float, other_db: float,
                separated: bool = False) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Features of a source in a random scene.

        Parameters:
            source (SAMPLES,): the sound from the direction that is judged.
            other (SAMPLES,): sound from another direction; None without.
            snr_db (dB): source over noise at a microphone.
            other_db (dB): the other sound over the source.
            separated: whether the direction of the other is known, so that its sound is removed.
        """
        rng = self._rng
        array, spectra, rooms = self._arrays[int(rng.integers(len(self._arrays)))]
        plain, places = bool(rng.random() < self._as_recorded), rooms[int(rng.integers(len(rooms)))]
        near, far = rng.permutation(len(places))[:2]
        in_room = rng.random() < IN_ROOM[plain]
        q, response = places[near] if in_room else (self._direction(array.rank), None)
        heard = self._arriving(source, array, q, response, plain)
        scale = np.std(heard) + 1e-12
        known = []
        if other is not None:
            apart, response = places[far] if in_room else (self._direction(array.rank), None)
            while np.linalg.norm(apart - q) < 0.25:
                apart, response = self._direction(array.rank), None
            added = self._arriving(other, array, apart, response, plain)
            heard = heard + added * scale / (np.std(added) + 1e-12) * 10.0 ** (other_db / 20.0)
            if separated:
                known = [apart + 0.02 * rng.standard_normal(array.rank)]
        noise = self._noise(heard.shape)
        heard = heard + noise * scale / np.std(noise) * 10.0 ** (-snr_db / 20.0)
        spectra.clear()
        spectra.add((heard / np.abs(heard).max() * 10.0 ** rng.uniform(-2.5, 0.0)).T.astype(np.float32))
        segment = spectra.steered([q + 0.02 * rng.standard_normal(array.rank), *known])[0]
        return self._features(segment), self._features.lines(segment)

    def _direction(self, rank: int) -> NDArray:
        vector = self._rng.standard_normal(3)
        return (vector / np.linalg.norm(vector))[:rank]

    def _arriving(self, sound: NDArray, array: MicrophoneArray, q: NDArray, response: NDArray | None,
                  plain: bool) -> NDArray:
        """A sound (m, n) at the microphones: coloured, with an echo of the ground, or in a room that it has filled."""
        rng, size = self._rng, len(sound)
        if response is None:
            if not plain and rng.random() < 0.6:
                sound = _with_echo(sound, rng)
            size = 2 * len(sound)
            frequency = np.fft.rfftfreq(size, 1.0 / RATE)
            lead = array.positions @ array.basis @ q / SPEED_OF_SOUND
            response = np.exp(2j * np.pi * frequency * lead[:, None])
        else:
            frequency = np.fft.rfftfreq(size, 1.0 / RATE)
            response = np.fft.rfft(response[:, :size], size)
        if not plain:
            response = response * self._colour(frequency)
        return np.fft.irfft(np.fft.rfft(sound, size) * response, size)[:, :len(sound)]

    def _colour(self, frequency: NDArray) -> NDArray:
        """Gain by frequency of microphone, air and distance."""
        rng = self._rng
        octaves = np.log2(np.maximum(frequency, 30.0) / 1000.0)
        gain_db = rng.normal(0.0, 2.5) * octaves + np.interp(octaves, np.arange(-5.0, 4.0), rng.normal(0.0, 3.0, 9))
        if rng.random() < 0.5:  # air over a distance, a cover, a codec
            gain_db = gain_db - 10.0 * np.log10(1.0 + (frequency / rng.uniform(1500.0, 8000.0)) ** rng.choice([2, 4, 16]))
        if rng.random() < 0.5:
            gain_db = gain_db - 10.0 * np.log10(1.0 + (rng.uniform(40.0, 250.0) / np.maximum(frequency, 5.0)) ** 4)
        return 10.0 ** (gain_db / 20.0)

    def _noise(self, shape: tuple[int, ...]) -> NDArray:
        rng = self._rng
        frequency = np.maximum(np.fft.rfftfreq(shape[1], 1.0 / RATE), 20.0)
        spectrum = np.fft.rfft(rng.standard_normal(shape)) * frequency ** -rng.uniform(0.0, 1.6)
        return np.fft.irfft(spectrum, shape[1])


def crop(samples: NDArray, rng: np.random.Generator) -> NDArray:
    """SAMPLES of a recording at a random place that is not much quieter than the rest; short ones are repeated."""
    if len(samples) < SAMPLES + 1:
        samples = np.tile(samples, SAMPLES // max(len(samples), 1) + 2)
    loud = np.std(samples)
    for _ in range(8):
        start = int(rng.integers(0, len(samples) - SAMPLES))
        part = samples[start:start + SAMPLES]
        if np.std(part) > 0.25 * loud:
            break
    return part


def _with_echo(sound: NDArray, rng: np.random.Generator) -> NDArray:
    """A sound with its reflection from the ground, whose delay changes as the source moves."""
    places = np.arange(len(sound))
    first = rng.uniform(0.0002, 0.012)
    delay = np.linspace(first, max(first + rng.uniform(-0.002, 0.002), 0.0), len(sound))
    return sound + rng.uniform(-0.3, 0.9) * np.interp(places - delay * RATE, places, sound, left=0.0)
