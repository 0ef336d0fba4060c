"""Accuracy and calibration of sigma while the source moves or the rig turns within the analysis window."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import resample

from av_audio.localizer import Localizer, LocalizerSettings
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction
from av_evaluation.hearing.accuracy import PAIR, Trials, azimuth_error, coverage, rms
from av_evaluation.hearing.figures import Figure
from av_evaluation.hearing.signals import RATE, Source, add_noise

WINDOW_S = 0.5
RATES_DEG = (0.0, 10.0, 20.0, 40.0)
SNRS_DB = (20.0, 10.0, 0.0, -5.0)
RANGES_M = (5.0, 30.0)
# Sound before and after the window, for the time that it travels, and the factor by which it is sampled more finely before
# it is interpolated: in the band the error of the cubic spline is below -90 dB.
PAD_S = 0.15
FINER = 4

# Times of emission (n, m) in s of the sound that reaches the microphones at times (n,) in s from the centre of the window,
# and the azimuth in rad from which the sound arrives at the centre of the array at time 0.
Arrival = tuple[NDArray, float]


def turning_rig(rng: Generator, times: NDArray, rate: float) -> Arrival:
    """A far source, and a rig that turns at `rate` in rad/s about the vertical."""
    azimuth = rng.uniform(-np.pi, np.pi)
    towards = angles_to_direction(azimuth - rate * times, np.zeros(len(times)))    # in the frame of the array
    return times[:, None] + towards @ PAIR.positions.T / speed_of_sound(20.0), azimuth


def passing_source(rng: Generator, times: NDArray, rate: float) -> Arrival:
    """A source 5 to 30 m away on a straight line, up to 45 deg from tangential, seen at `rate` in rad/s at time 0."""
    c = speed_of_sound(20.0)
    azimuth, distance, slant = rng.uniform(-np.pi, np.pi), rng.uniform(*RANGES_M), rng.uniform(-np.pi / 4.0, np.pi / 4.0)
    towards = angles_to_direction(azimuth)
    across = np.array([-towards[1], towards[0], 0.0])
    velocity = rate * distance * (across + np.tan(slant) * towards)
    emitted = np.repeat(times[:, None], PAIR.channels, axis=1)
    for _ in range(6):    # contracts by the Mach number
        away = distance * towards + (emitted[..., None]) * velocity - PAIR.positions
        emitted = times[:, None] - (np.linalg.norm(away, axis=-1) - distance) / c
    return emitted, azimuth


def heard(sound: NDArray, emitted: NDArray) -> NDArray:
    """Sound (n, m) that was emitted at times (n, m) in s from the middle of `sound` (k,)."""
    fine = resample(sound, FINER * len(sound))
    times = np.arange(len(fine)) / (FINER * RATE) - 0.5 * len(sound) / RATE
    return CubicSpline(times, fine)(emitted)


def moving_trials(rng: Generator, source: Source, arrival: Callable[[Generator, NDArray, float], Arrival], rate: float,
                  snr_db: float, count: int) -> Trials:
    """Results of independent windows in which the source moves relative to the array, to either side.

    Parameters:
        rng: random numbers.
        source: generates the sound.
        arrival: the motion.
        rate (rad/s): relative angular rate.
        snr_db (dB): signal-to-noise ratio inside the band.
        count: number of windows.
    """
    localizer = Localizer(PAIR, RATE, LocalizerSettings(window_s=WINDOW_S, hop_s=WINDOW_S))
    times = np.arange(round(WINDOW_S * RATE)) / RATE - 0.5 * WINDOW_S
    rows: list[tuple[float, float, float]] = []
    for _ in range(count):
        emitted, azimuth = arrival(rng, times, rng.choice([-1.0, 1.0]) * rate)
        sound = source(rng, WINDOW_S + 2.0 * PAD_S, np.zeros(1))[:, 0]
        estimate, = localizer.process(add_noise(rng, heard(sound, emitted), snr_db), localizer.next_sample)
        rows.append((azimuth_error(estimate, azimuth), float(np.degrees(np.sqrt(estimate.azimuth_variance[0]))),
                     float(estimate.confidence[0])))
    return Trials(*np.array(rows).T)


def pulsing(source: Source, depth: float = 0.9) -> Source:
    """A source whose amplitude varies by `depth` at 1 to 8 Hz, as gusts, rotors that beat, and vegetation do.

    Parameters:
        source: the steady source.
        depth: relative amplitude of the variation, 0 to 1.
    """
    def sound(rng: Generator, seconds: float, delays: NDArray) -> NDArray:
        times = np.arange(round(seconds * RATE))[:, None] / RATE - delays
        envelope = 1.0 + depth * np.sin(2.0 * np.pi * (rng.uniform(1.0, 8.0) * times + rng.uniform()))
        return envelope * source(rng, seconds, delays)

    return sound


def motion(count: int, sources: dict[str, Source]) -> Iterator[Figure]:
    """Errors within 1.64 sigma, RMSE and median error by relative rate, source, and what moves; confident estimates only.

    Parameters:
        count: windows per rate, source and motion, of all SNRs together.
        sources: generators of sound by name.
    """
    sources = {**sources, 'pulsing rotors': pulsing(sources['rotors']), 'pulsing noise': pulsing(sources['flat noise'])}
    for rate in RATES_DEG:
        everything = []
        for what, arrival in (('rig turns', turning_rig), ('source passes', passing_source)):
            for name, source in sources.items():
                rng = np.random.default_rng(37)
                parts = [moving_trials(rng, source, arrival, np.radians(rate), snr_db, max(1, count // len(SNRS_DB)))
                         for snr_db in SNRS_DB]
                everything += parts
                yield from _figures(f'{rate:g} deg/s, {what}, {name}', parts)
        for snr_db in SNRS_DB:
            yield from _figures(f'{rate:g} deg/s, {snr_db:+.0f} dB', everything[SNRS_DB.index(snr_db)::len(SNRS_DB)])
        yield from _figures(f'{rate:g} deg/s, all', everything, 95.0, 85.0)


def _figures(name: str, parts: list[Trials], at_most: float | None = None, at_least: float | None = None) -> Iterator[Figure]:
    result = Trials(*(np.concatenate([getattr(part, field) for part in parts]) for field in ('error', 'sigma', 'confidence')))
    passed = result.error[result.passed]
    yield Figure(f'{name}: errors within 1.64 sigma', coverage(result), '%', at_most, at_least)
    yield Figure(f'{name}: RMSE', rms(passed), 'deg')
    yield Figure(f'{name}: median error', float(np.median(passed)), 'deg')
    yield Figure(f'{name}: share above the default confidence', 100.0 * result.passed.mean(), '%')
