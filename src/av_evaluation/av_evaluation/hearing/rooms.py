"""Rooms and a head: the default against correlations with even weights in the same windows, and a calibrated head."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy import signal

from av_audio.localizer import DoaEstimate, Localizer, LocalizerSettings
from av_common.angles import wrap
from av_evaluation.figures import Figure
from av_evaluation.hearing.free_field import CONFIDENCE_THRESHOLD, FAR_OFF_DEG, azimuth_error, rms
from av_evaluation.hearing.peers import gcc_phat, of_library
from av_evaluation.hearing.places import (
    Field,
    Head,
    Window,
    at_ears,
    calibrated_ears,
    free_field,
    read_responses,
    rooms,
    with_own_noise,
)
from av_evaluation.hearing.signals import RATE, Source, load_clip

ROOMS = 100
# The default may be worse than the best of the others by this factor.
MARGIN = 1.05
SETTINGS = {
    'default': LocalizerSettings(), 'published band': LocalizerSettings(wideband=False),
    **{method: LocalizerSettings(method=method) for method in ('phat', 'music', 'mvdr')}}
EVEN = ('phat', 'GCC-PHAT', 'SRP-PHAT')


def robust(count: int, sources: dict[str, Source], data: Path) -> Iterator[Figure]:
    """Median error, RMSE and share beyond 20 degrees by field and estimator; with sigma and confidence for the default.

    Parameters:
        count: windows per field.
        sources: generators of sound by name.
        data: folder with recordings and measured responses.
    """
    drones = [source for name, source in sources.items() if name != 'flat noise']
    indoors = rooms(np.random.default_rng(61), min(count, ROOMS), drones)
    slower = rooms(np.random.default_rng(62), min(count, ROOMS), drones, 16_000)
    head, free = Head(data), free_field(list(sources.values()))
    for name, field, window_s, snr_db in (
            ('rooms', indoors, 0.5, 10.0), ('rooms at 16 kHz', slower, 0.5, 10.0), ('rooms', indoors, 0.2, 10.0),
            ('rooms', indoors, 0.1, 10.0), ('rooms', indoors, 0.5, 0.0),
            ('head', head.field(drones, False), 0.1, 20.0), ('head, reflections', head.field(drones, True), 0.1, 20.0),
            ('head, reflections', head.field(drones, True), 0.5, 20.0),
            *(('free field', free, 0.5, snr_db) for snr_db in (20.0, 10.0, 0.0, -5.0, -10.0)),
            ('free field', free, 0.1, 10.0), ('free field', free, 0.1, 0.0)):
        yield from _field_figures(f'{name}, {window_s:g} s, {snr_db:+.0f} dB', field, window_s, snr_db, count)


def kemar(data: Path) -> Iterator[Figure]:
    """Drone recordings convolved with measured responses of a head; calibrated at every other azimuth, tested at the rest."""
    azimuths, responses, rate = read_responses(data / 'kemar' / 'mit_kemar_normal_pinna.sofa')
    common = np.gcd(rate, RATE)
    clips = [signal.resample_poly(load_clip(path), rate // common, RATE // common)
             for path in sorted((data / 'drone_detection' / 'audio').glob('DRONE_*.flac'))]
    if not clips:
        raise FileNotFoundError(f'no drone recordings in {data}')
    array = calibrated_ears(azimuths, responses, rate, [clip[:2 * rate] for clip in clips])
    results = [(np.degrees(wrap(azimuths[k])), azimuth_error(estimate, azimuths[k]))
               for k in range(1, len(azimuths), 2) for clip in clips
               for estimate in Localizer(array, rate, LocalizerSettings(hop_s=0.5)).process(
                   with_own_noise(at_ears(clip[5 * rate:7 * rate], responses[k])), 0)]
    truth, errors = np.array(results).T
    yield Figure('KEMAR, |azimuth| <= 60 deg: mean error', float(errors[np.abs(truth) <= 60.0].mean()), 'deg', 1.5)
    yield Figure('KEMAR, all azimuths, folded: mean error', errors.mean(), 'deg', 3.0)
    yield Figure('KEMAR, all azimuths, folded: RMSE', rms(errors), 'deg')
    yield Figure('KEMAR, all azimuths, folded: errors above 20 deg', 100.0 * np.mean(errors > 20.0), '%')
    yield Figure('KEMAR, all azimuths, folded: largest error', errors.max(), 'deg')


def _field_figures(name: str, field: Field, window_s: float, snr_db: float, count: int) -> Iterator[Figure]:
    rng = np.random.default_rng(63)
    others: dict[str, Callable[[Window], float]] = {
        'GCC-PHAT': lambda heard: gcc_phat(heard.sound, heard.array, heard.rate),
        'SRP-PHAT': lambda heard: of_library('SRP', heard.sound, heard.array, heard.rate)}
    rows: list[list[float]] = []
    marks: list[tuple[float, float]] = []
    for _ in range(count):
        window = field(rng, window_s, snr_db)
        estimates = {method: _localize(window, settings) for method, settings in SETTINGS.items()}
        azimuths = [float(np.arcsin(np.sin(estimate.azimuth[0]))) for estimate in estimates.values()]
        azimuths += [locate(window) for locate in others.values()]
        rows.append([float(np.degrees(abs(azimuth - np.arcsin(window.cosine)))) for azimuth in azimuths])
        default = estimates['default']
        marks.append((float(default.confidence[0]), float(np.degrees(np.sqrt(default.azimuth_variance[0])))))
    errors = dict(zip([*SETTINGS, *others], np.array(rows).T, strict=True))
    for method, error in errors.items():
        yield Figure(f'{name}, {method}: median error', float(np.median(error)), 'deg')
        yield Figure(f'{name}, {method}: RMSE', rms(error), 'deg')
        yield Figure(f'{name}, {method}: beyond 20 deg', 100.0 * float(np.mean(error > FAR_OFF_DEG)), '%')
    for what, measure in (('median', np.median), ('RMSE', rms)):
        best = min(float(measure(errors[method])) for method in EVEN)
        yield Figure(f'{name}: {what} over the best of PHAT, GCC-PHAT and SRP', float(measure(errors['default'])) / best, '',
                     MARGIN)
    confidence, sigma = np.array(marks).T
    passed = confidence >= CONFIDENCE_THRESHOLD
    error = errors['default'][passed]
    yield Figure(f'{name}: above the default confidence', 100.0 * float(passed.mean()), '%')
    yield Figure(f'{name}: of those beyond 20 deg', 100.0 * float(np.mean(error > FAR_OFF_DEG)), '%', 3.0)
    yield Figure(f'{name}: of those within 1.64 sigma', 100.0 * float(np.mean(error < 1.64 * sigma[passed])), '%')


def _localize(window: Window, settings: LocalizerSettings) -> DoaEstimate:
    localizer = Localizer(window.array, window.rate, LocalizerSettings(
        window_s=len(window.sound) / window.rate, method=settings.method, wideband=settings.wideband))
    estimate, = localizer.process(window.sound, 0)
    return estimate
