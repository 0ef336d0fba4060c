"""Rooms and a head: the default against correlations with even weights in the same windows, and a calibrated head."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from av_audio.localizer import Localizer, LocalizerSettings
from av_common.angles import wrap
from av_evaluation.hearing.peers import PEERS
from av_evaluation.hearing.places import (
    HEAD_WINDOW_S,
    KEMAR,
    Field,
    Head,
    at_ears,
    calibrated_ears,
    free_field,
    read_responses,
    rooms,
    windows_of,
    with_own_noise,
)
from av_evaluation.hearing.signals import Source, drone_files, load_clip
from av_evaluation.hearing.trials import Figure, Found, Locate, Window, compare, error_figures, ours
from av_evaluation.metrics.metrics import rmse

ROOMS = 100  # of which windows are drawn
# The default may be worse than the best of the others by this factor.
MARGIN = 1.05
SETTINGS = {
    'default': LocalizerSettings(),
    **{method: LocalizerSettings(method=method) for method in ('phat', 'music', 'mvdr')}}
EVEN = ('phat', 'GCC-PHAT', 'SRP-PHAT')


def robust(count: int, sources: dict[str, Source], data: Path) -> Iterator[Figure]:
    """Errors by field and estimator, and those of the default over the best of those with even weights.

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


def heads(data: Path, responses: Sequence[Path] = ()) -> Iterator[Figure]:
    """Drone recordings convolved with measured responses of a head; calibrated at every other azimuth, tested at the rest.

    Each method is calibrated by its own directions; mirror images are folded.

    Parameters:
        data: folder with recordings, and with the responses of KEMAR.
        responses: SOFA files of another head instead of KEMAR. It is calibrated by the first and tested by the last one, such
            as one of the same head in a room.

    Raises FileNotFoundError, and ValueError for a file without responses of two ears.
    """
    files = list(responses) or [data / KEMAR]
    known, tested = read_responses(files[0]), read_responses(files[-1])
    teaching = [load_clip(file, known.rate)[:2 * known.rate] for file in drone_files(data)]
    clips, truth = [load_clip(file, tested.rate) for file in drone_files(data)], np.degrees(wrap(tested.azimuths[1::2]))
    heard = [(sound, azimuth) for azimuth, response in zip(tested.azimuths[1::2], tested.responses[1::2], strict=True)
             for clip in clips
             for sound in windows_of(with_own_noise(at_ears(clip[5 * tested.rate:7 * tested.rate], response)), tested.rate)]
    for name, locate in {'ours': None, **PEERS}.items():
        array = calibrated_ears(known, teaching, locate)
        used = locate or ours(Localizer(array, tested.rate, LocalizerSettings(hop_s=HEAD_WINDOW_S)))
        errors = compare((Window(sound, tested.rate, array, azimuth) for sound, azimuth in heard), {name: used})[name].error
        limits, title = (1.5, 3.0) if locate is None else (None, None), f'{files[-1].stem}, {name}'
        ahead = errors.reshape(len(truth), -1)[np.abs(truth) <= 60.0]
        yield Figure(f'{title}, |azimuth| <= 60 deg: mean error', ahead.mean(), 'deg', limits[0])
        yield Figure(f'{title}: mean error', errors.mean(), 'deg', limits[1])
        yield Figure(f'{title}: largest error', errors.max(), 'deg')


def _field_figures(name: str, field: Field, window_s: float, snr_db: float, count: int) -> Iterator[Figure]:
    rng = np.random.default_rng(63)
    methods: dict[str, Locate] = {method: partial(_localize, settings) for method, settings in SETTINGS.items()}
    methods |= {method: PEERS[method] for method in ('GCC-PHAT', 'SRP-PHAT')}
    results = compare((field(rng, window_s, snr_db) for _ in range(count)), methods)
    for method, result in results.items():
        yield from error_figures(f'{name}, {method}', result, {'of those beyond 20 deg': 3.0} if method == 'default' else {})
    default = results['default']
    for what, measure in (('median', np.median), ('RMSE', rmse)):
        best = min(float(measure(results[method].error)) for method in EVEN)
        ratio = float(measure(default.error)) / best
        yield Figure(f'{name}: {what} over the best of PHAT, GCC-PHAT and SRP', ratio, '', MARGIN)


def _localize(settings: LocalizerSettings, window: Window) -> Found:
    """By a localizer of its own, as arrays and lengths of windows differ."""
    settings = replace(settings, window_s=len(window.sound) / window.rate)
    return ours(Localizer(window.array, window.rate, settings))(window)
