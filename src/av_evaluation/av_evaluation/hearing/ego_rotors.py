"""Accuracy under the sound of the rig's own rotors, with and without notches."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from av_audio.localizer import Localizer, LocalizerSettings
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction
from av_evaluation.hearing.accuracy import CONFIDENCE_THRESHOLD, PAIR, azimuth_error
from av_evaluation.hearing.figures import Figure
from av_evaluation.hearing.signals import RATE, add_noise, band_power, rotors

WINDOW_S = 0.5
# A quadrotor with arms of 0.25 m around the pair, 5 cm below it.
EGO_ROTORS = np.array([[0.18, 0.18, -0.05], [-0.18, 0.18, -0.05], [-0.18, -0.18, -0.05], [0.18, -0.18, -0.05]])
BROADBAND_DB = -15.0
TARGET_SNR_DB = 10.0
MAX_ERROR_DEG = 3.0


def ego_rotors(count: int) -> Iterator[Figure]:
    """Median error for a target 10 dB above white noise, by the level of the ego-rotors relative to the target."""
    for name in ('ignored', 'known', 'estimated'):
        settings = LocalizerSettings(hop_s=WINDOW_S, estimated_rotors=4 if name == 'estimated' else 0)
        tolerated = -np.inf
        for level_db in (-10.0, -5.0, 0.0, 5.0, 10.0, 15.0, 20.0):
            rng = np.random.default_rng(61)
            errors, passed = [], []
            for _ in range(count):
                azimuth = rng.uniform(-np.pi, np.pi)
                sound, blade_pass = scene(rng, azimuth, level_db)
                localizer = Localizer(PAIR, RATE, settings)
                localizer.blade_pass_hz = blade_pass if name == 'known' else np.zeros(0)
                estimate, = localizer.process(sound, 0)
                errors.append(azimuth_error(estimate, azimuth))
                passed.append(estimate.confidence[0] >= CONFIDENCE_THRESHOLD)
            median = float(np.median(errors))
            if median < MAX_ERROR_DEG:
                tolerated = level_db
            yield Figure(f'ego-rotors {name}, {level_db:+.0f} dB over the target: median error', median, 'deg')
        yield Figure(f'ego-rotors {name}: loudest with a median error below {MAX_ERROR_DEG:g} deg', tolerated, 'dB')


def scene(rng: Generator, azimuth: float, level_db: float) -> tuple[NDArray, NDArray]:
    """Sound (n, 2) of a target, ego-rotors and noise, and the blade-pass frequencies (4,) of the ego-rotors in Hz.

    The ego-rotors are point sources near the microphones with spherical spreading; the amplitudes of their harmonics k
    decrease as 1/k.

    Parameters:
        rng: random numbers.
        azimuth (rad): direction of the target.
        level_db (dB): level of the ego-rotors relative to the target.
    """
    arrivals = -PAIR.positions @ angles_to_direction(azimuth) / speed_of_sound(20.0)
    target = rotors(rng, WINDOW_S, arrivals)
    blade_pass = rng.uniform(150.0, 220.0, len(EGO_ROTORS))
    time = np.arange(round(WINDOW_S * RATE))[:, None] / RATE
    ego = np.zeros(target.shape)
    for fundamental, position in zip(blade_pass, EGO_ROTORS, strict=True):
        distances = np.linalg.norm(PAIR.positions - position, axis=1)
        turn = np.exp(2j * np.pi * fundamental * (time - distances / speed_of_sound(20.0)))
        orders = np.arange(1, int(4500.0 / fundamental))
        amplitudes = np.concatenate([[0.0], np.exp(2j * np.pi * rng.uniform(size=orders.size)) / orders])
        ego += np.polynomial.polynomial.polyval(turn, amplitudes).real / distances
    ego /= np.sqrt(band_power(ego[:, 0]))
    hiss = rng.normal(size=ego.shape)
    ego += 10.0 ** (BROADBAND_DB / 20.0) * hiss / np.sqrt(band_power(hiss[:, 0]))
    gain = 10.0 ** (level_db / 20.0) * np.sqrt(band_power(target[:, 0]) / band_power(ego[:, 0]))
    both = target + gain * ego
    louder_db = 10.0 * np.log10(band_power(both[:, 0]) / band_power(target[:, 0]))
    return add_noise(rng, both, TARGET_SNR_DB + louder_db), blade_pass
