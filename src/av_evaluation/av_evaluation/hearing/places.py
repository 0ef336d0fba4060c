"""Places in which sound is heard: rooms of pyroomacoustics, the measured ears of a head, and the free field."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy import signal

from av_audio.calibration import calibrate, measured_path, search_array
from av_audio.localizer import Localizer, LocalizerSettings
from av_common.angles import angles_to_direction, wrap
from av_common.microphone_array import MicrophoneArray
from av_evaluation.hearing.signals import RATE, Source, add_noise
from av_evaluation.hearing.trials import C, Locate, Window

OWN_NOISE = 10.0**(-50.0 / 20.0)    # of a microphone, relative to the sound
GRID = math.radians(5.0)    # between measured directions of the ears
HEAD_WINDOW_S = 0.5  # at the ears
KEMAR = Path('kemar', 'mit_kemar_normal_pinna.sofa')
EARS = MicrophoneArray(np.array([[0.0, 0.09, 0.0], [0.0, -0.09, 0.0]]), 'kemar')  # m; their delays are measured
T60_S = (0.2, 0.7)  # of furnished to bare rooms
SPACING_M = (0.1, 0.2)  # of pairs
DISTANCE_M = (2.0, 6.0)  # of sources
LARGEST_ORDER = 45    # of reflections, which later ones hardly exceed
SETTLED_S = 0.8    # of sound before a window in a room
# Early reflections at the head: number, delay, gain; and the decay and level of what follows, relative to the direct sound.
REFLECTIONS = (1, 4)
REFLECTION_DELAY_S = (0.0008, 0.02)  # a way of 0.3 to 7 m
REFLECTION_GAIN = (0.2, 0.7)  # of floor, walls and furniture near by
TAIL_S = 0.3  # its length
TAIL_T60_S = (0.2, 0.6)  # of its decay
TAIL_LEVEL = (0.1, 0.6)  # amplitude over that of the direct sound


# Makes one window of a given length in s and SNR in dB from random numbers.
Field = Callable[[Generator, float, float], Window]


def shoebox(size: NDArray, t60: float, largest_order: int = LARGEST_ORDER, rate: int = RATE) -> Any:
    """An empty `pyroomacoustics.ShoeBox` at 20 degrees Celsius.

    Parameters:
        size (3,): of the room in m.
        t60 (s): reverberation time, which gives the absorption by Sabine's formula.
        largest_order: of reflections.
        rate (Hz): of samples.

    Raises ImportError without pyroomacoustics, ValueError for a room that is too large for so short a reverberation.
    """
    import pyroomacoustics
    absorption, order = pyroomacoustics.inverse_sabine(t60, size)
    room = pyroomacoustics.ShoeBox(size, fs=rate, materials=pyroomacoustics.Material(absorption),
                                   max_order=min(order, largest_order))
    room.set_sound_speed(C)
    return room


class Responses(NamedTuple):
    """Measured horizontal impulse responses of two ears.

    Parameters:
        azimuths (n,): rad, counter-clockwise, by increasing positive angle.
        responses (n, 2, taps): left and right ear.
        rate: sample rate in Hz.
    """

    azimuths: NDArray
    responses: NDArray
    rate: int


def read_responses(path: Path) -> Responses:
    """The horizontal responses of a SOFA file of a head, in any order (AES69).

    In some files the ears are exchanged or azimuths clockwise: the ear that is on the side of the sources hears them first.

    Raises FileNotFoundError, ValueError for a file without responses of two ears at several azimuths.
    """
    import h5py
    if not path.is_file():
        raise FileNotFoundError(f'{path} does not exist')
    try:
        with h5py.File(path) as file:
            positions, impulses, rate = file['SourcePosition'][:], file['Data.IR'][:], int(file['Data.SamplingRate'][0])
        level = np.flatnonzero(np.abs(positions[:, 1]) < 0.1)
    except (OSError, KeyError, IndexError, TypeError, ValueError) as error:
        raise ValueError(f'{path} is no SOFA file of impulse responses: {error}') from error
    if impulses.ndim != 3 or impulses.shape[1] != 2 or len(impulses) != len(positions) or rate <= 0 or len(level) < 3:
        raise ValueError(f'{path} has responses of shape {impulses.shape} at {rate} Hz, {len(level)} of them horizontal; '
                         'expected two ears and several azimuths')
    order = level[np.argsort(np.mod(positions[level, 0], 360.0))]
    azimuths, responses = np.radians(positions[order, 0]), impulses[order]
    arrivals = np.argmax(np.abs(responses), axis=2) @ [-1.0, 1.0]
    return Responses(azimuths, responses if arrivals @ np.sin(azimuths) >= 0.0 else responses[:, ::-1], rate)


def at_ears(sound: NDArray, response: Sequence[NDArray] | NDArray) -> NDArray:
    """Sound (n, 2) of a source (n,) at two ears, or microphones, each with a response (taps,)."""
    return np.stack([signal.fftconvolve(sound, ear)[:len(sound)] for ear in response], axis=1)


def towards(azimuth: NDArray, azimuths: NDArray, responses: NDArray) -> Iterator[tuple[NDArray, NDArray]]:
    """Shares (n,) and responses (2, taps) of the measured directions next to a source that moves: linear interpolation.

    That is accurate below 4 kHz, where 5 degrees are a small part of a period.

    Parameters:
        azimuth (n,) (rad): of the source by sample.
        azimuths (k,) (rad), responses (k, 2, taps): measured directions, GRID apart, and impulse responses.
    """
    place = np.unwrap(azimuth) / GRID
    for index in range(math.floor(place.min()), math.floor(place.max()) + 2):
        nearest = np.argmin(np.abs(wrap(azimuths - index * GRID)))
        yield np.clip(1.0 - np.abs(place - index), 0.0, None), responses[nearest]


def with_own_noise(sound: NDArray) -> NDArray:
    """Sound (n, 2) with the noise of the microphones, without which equal responses make equal channels, as copies are."""
    noise = OWN_NOISE * sound.std() * np.random.default_rng(0).normal(size=sound.shape)
    return (sound + noise).astype(sound.dtype)


def calibrated_ears(known: Responses, sounds: Sequence[NDArray], locate: Locate | None = None) -> MicrophoneArray:
    """EARS, calibrated at every other azimuth.

    Parameters:
        known: responses of both ears.
        sounds: sounds (m,) that are heard from each of the azimuths.
        locate: method whose directions are calibrated; None for the default.
    """
    angles, paths = list[float](), list[float]()
    for azimuth, response in zip(known.azimuths[::2], known.responses[::2], strict=True):
        for sound in sounds:
            path = _paths(with_own_noise(at_ears(sound, response)), known.rate, locate)
            paths.extend(path)
            angles.extend([azimuth] * len(path))
    return calibrate(EARS, angles, paths).array


def _paths(sound: NDArray, rate: int, locate: Locate | None) -> NDArray:
    """Differences of paths (k,) in m that a method, or the default, measures in each half second of sound (n, 2)."""
    array = search_array(EARS)
    if locate is None:
        localizer = Localizer(array, rate, LocalizerSettings(hop_s=HEAD_WINDOW_S))
        return measured_path(EARS, localizer.process(sound, 0))[1]
    return array.aperture * np.sin([locate(Window(window, rate, array, np.nan))[0][0] for window in windows_of(sound, rate)])


def windows_of(sound: NDArray, rate: int) -> list[NDArray]:
    """Half seconds of sound (n, 2) at a sample rate in Hz."""
    return np.split(sound, round(len(sound) / (HEAD_WINDOW_S * rate)))


def pair(spacing: float) -> MicrophoneArray:
    """Two microphones `spacing` m apart, left and right."""
    return MicrophoneArray(np.array([[0.0, 0.5 * spacing, 0.0], [0.0, -0.5 * spacing, 0.0]]))


PAIR = pair(0.2)


def free_field(sources: list[Source], azimuths_deg: tuple[float, float] = (-180.0, 180.0)) -> Field:
    """Plane waves at PAIR.

    Parameters:
        sources: generators of sound, of which each window has one.
        azimuths_deg (deg): range from which azimuths are drawn uniformly.
    """
    def window(rng: Generator, seconds: float, snr_db: float) -> Window:
        azimuth = float(np.radians(rng.uniform(*azimuths_deg)))
        source = sources[rng.integers(len(sources))]
        sound = source(rng, seconds, -PAIR.positions @ angles_to_direction(azimuth) / C)
        return Window(add_noise(rng, sound, snr_db), RATE, PAIR, azimuth)

    return window


def rooms(rng: Generator, count: int, sources: list[Source], rate: int = RATE) -> Field:
    """Windows in one of `count` shoebox rooms, whose responses are computed once by pyroomacoustics.

    Parameters:
        rng: random numbers of the rooms.
        count: number of rooms.
        sources: generators of sound.
        rate (Hz): sample rate of the windows.
    """
    responses = [_random_response(rng) for _ in range(count)]

    def window(rng: Generator, seconds: float, snr_db: float) -> Window:
        response, array, azimuth = responses[rng.integers(count)]
        dry = sources[rng.integers(len(sources))](rng, SETTLED_S + seconds, np.zeros(1))[:, 0]
        wet = at_ears(dry, response)[-round(seconds * RATE):]
        sound = signal.resample_poly(add_noise(rng, wet, snr_db), rate, RATE, axis=0)
        return Window(sound, rate, array, azimuth)

    return window


def _random_response(rng: Generator) -> tuple[list[NDArray], MicrophoneArray, float]:
    """Responses of both microphones in a random room, the pair, and the azimuth (rad) on the cone of the source."""
    while True:
        size, t60 = rng.uniform([4.0, 3.5, 2.5], [10.0, 8.0, 4.0]), rng.uniform(*T60_S)
        place = rng.uniform([0.5, 0.5, 1.0], [size[0] - 0.5, size[1] - 0.5, 1.8])
        azimuth, yaw = rng.uniform(-np.pi, np.pi, 2)
        away = rng.uniform(*DISTANCE_M) * angles_to_direction(azimuth + yaw) + np.array([0.0, 0.0, rng.uniform(-0.3, 0.7)])
        if np.any(place + away < 0.4) or np.any(place + away > size - 0.4):
            continue
        try:
            room = shoebox(size, t60)
        except ValueError:
            continue
        array, axis = pair(rng.uniform(*SPACING_M)), np.array([-np.sin(yaw), np.cos(yaw), 0.0])
        room.add_source(place + away)
        room.add_microphone_array((place + array.positions[:, 1:2] * axis).T)
        room.compute_rir()
        return [microphone[0] for microphone in room.rir], array, float(np.arcsin(axis @ away / np.linalg.norm(away)))


def diffuse_tail(rng: Generator, direct: NDArray, rate: int) -> NDArray:
    """Late part (2, taps) of an impulse response, TAIL_S long: noise that decays and differs between the ears.

    Parameters:
        rng: random numbers.
        direct (2, k): response of the direct sound, whose energy is the reference.
        rate (Hz): sample rate.
    """
    times = np.arange(round(TAIL_S * rate)) / rate
    tail = rng.normal(size=(2, len(times))) * 10.0 ** (-3.0 * times / rng.uniform(*TAIL_T60_S))
    tail[:, times < REFLECTION_DELAY_S[1]] = 0.0
    energy = np.sum(direct**2) / np.sum(tail**2)
    return np.asarray(rng.uniform(*TAIL_LEVEL) * np.sqrt(energy) * tail)


class Head:
    """Windows at the measured ears of KEMAR, calibrated at every other azimuth with white noise.

    Attributes:
        azimuths (k,) (rad), responses (k, 2, taps): measured directions and impulse responses.
        rate (Hz): their sample rate.
        array: the calibrated ears.

    Parameters:
        data: folder with the measured responses.

    Raises FileNotFoundError.
    """

    def __init__(self, data: Path) -> None:
        known = read_responses(data / KEMAR)
        self.azimuths, self.responses, self.rate = known
        noise = 0.05 * np.random.default_rng(1).normal(size=self.rate)
        self.array = calibrated_ears(known, [noise])

    def field(self, sources: list[Source], reflections: bool) -> Field:
        """Windows of sound at the ears.

        Parameters:
            sources: generators of sound.
            reflections: whether strong early reflections and reverberation are added.
        """
        def window(rng: Generator, seconds: float, snr_db: float) -> Window:
            k = int(rng.integers(len(self.azimuths)))
            response = self._reverberant(rng, k) if reflections else self.responses[k]
            dry = sources[rng.integers(len(sources))](rng, seconds + 0.4, np.zeros(1))[:, 0]
            dry = signal.resample_poly(dry, self.rate, RATE)
            sound = add_noise(rng, at_ears(dry, response)[-round(seconds * self.rate):], snr_db)
            return Window(sound, self.rate, self.array, float(self.azimuths[k]))

        return window

    def _reverberant(self, rng: Generator, k: int) -> NDArray:
        """Responses (2, taps) of direction k with reflections from others, and a diffuse tail."""
        taps = self.responses.shape[2]
        response = np.zeros((2, round(TAIL_S * self.rate)))
        response[:, :taps] = self.responses[k]
        for _ in range(rng.integers(*REFLECTIONS)):
            start = round(rng.uniform(*REFLECTION_DELAY_S) * self.rate)
            gain = rng.uniform(*REFLECTION_GAIN)
            response[:, start:start + taps] += gain * self.responses[rng.integers(len(self.azimuths))]
        return response + diffuse_tail(rng, self.responses[k], self.rate)
