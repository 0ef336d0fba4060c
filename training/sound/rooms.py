"""Impulse responses of sources in shoebox rooms, by image sources (Allen and Berkley, 1979; pyroomacoustics)."""

from __future__ import annotations

import numpy as np
from material import RATE
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation
from waves import log_uniform

from av_common.microphone_array import MicrophoneArray
from av_evaluation.hearing.places import shoebox

SMALLEST_M, LARGEST_M, WALL_M = (3.0, 3.0, 2.3), (14.0, 11.0, 5.0), 0.3
SOURCES, NEAREST_M = 4, 0.6
T60_S, DIRECT_DB = (0.2, 1.0), (-6.0, 10.0)  # reverberation time; direct sound over all else
LARGEST_ORDER = 35  # of reflections
DULLER = 1.0, 3.0  # decay of high over that of low frequencies
BEFORE, DIRECT = 60, 24  # samples of a response before its maximum that are kept, and of the direct sound after it


def room(array: MicrophoneArray, rng: np.random.Generator) -> list[tuple[NDArray, NDArray]]:
    """Projected directions (rank,) and impulse responses (m, taps) of sources in a random shoebox room (image sources).

    High frequencies decay faster; the level of the direct sound over all else is drawn.
    """
    while True:
        size, t60 = rng.uniform(SMALLEST_M, LARGEST_M), log_uniform(rng, *T60_S)
        try:
            box = shoebox(size, t60, LARGEST_ORDER, RATE)
            break
        except ValueError:  # too large for so short a reverberation
            continue
    turn = Rotation.from_euler('ZYX', [rng.uniform(-np.pi, np.pi), *rng.normal(0.0, 0.1, 2)])
    place = rng.uniform(2.0 * WALL_M, size - 2.0 * WALL_M)
    box.add_microphone_array((place + turn.apply(array.positions)).T)
    directions = list[NDArray]()
    while len(directions) < SOURCES:
        source = rng.uniform(WALL_M, size - WALL_M)
        away = turn.inv().apply(source - place)
        distance = float(np.linalg.norm(away))
        if distance > NEAREST_M:
            box.add_source(source)
            directions.append(array.basis.T @ away / distance)
    box.compute_rir()
    sos = butter(1, rng.uniform(800.0, 4000.0), output='sos', fs=RATE)
    duller = rng.uniform(*DULLER)
    places = []
    for number, q in enumerate(directions):
        responses = [np.asarray(one[number]) for one in box.rir]
        response = np.stack([np.pad(one, (0, max(map(len, responses)) - len(one))) for one in responses])
        first = int(np.min(np.argmax(np.abs(response), axis=1)))
        direct, rest = np.split(response, [first + DIRECT], axis=1)
        low = sosfiltfilt(sos, rest, axis=1)
        rest = low + (rest - low) * 10.0 ** (-3.0 * (duller - 1.0) / t60 * np.arange(rest.shape[1]) / RATE)
        rest *= 10.0 ** (-rng.uniform(*DIRECT_DB) / 20.0) * np.sqrt(np.sum(direct**2) / np.sum(rest**2))
        places.append((q, np.concatenate([direct, rest], axis=1)[:, max(first - BEFORE, 0):].astype(np.float32)))
    return places
