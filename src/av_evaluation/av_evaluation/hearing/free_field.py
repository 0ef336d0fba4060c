"""A pair of microphones in the free field: accuracy and sigma; what the stage of hearing costs."""

from __future__ import annotations

from collections.abc import Iterator
from time import process_time

import numpy as np
from std_msgs.msg import Header

from av_audio.drone_classifier import load_model
from av_audio.localizer import Localizer, LocalizerSettings
from av_audio.messages import audio_frame
from av_audio.stage import DoaStage
from av_common.angles import angles_to_direction
from av_common.stamps import to_stamp
from av_evaluation.hearing.places import PAIR, free_field
from av_evaluation.hearing.reach import ARRAYS
from av_evaluation.hearing.signals import BAND_HZ, RATE, Source, add_noise, flat, rotors
from av_evaluation.hearing.trials import C, Figure, Trials, compare, error_figures, ours, share
from av_evaluation.metrics.metrics import rmse

WINDOW_S = 0.5  # the default of doa_node
COST_S = 10.0  # of sound, of which the processor time is measured
SETTINGS = LocalizerSettings(window_s=WINDOW_S, hop_s=WINDOW_S)


def _trials(seed: int, source: Source, snr_db: float, count: int, azimuths_deg: tuple[float, float] = (-180.0, 180.0)
            ) -> Trials:
    """Results of independent windows of a pair at an SNR in dB, from azimuths drawn uniformly from a range in deg."""
    rng, field = np.random.default_rng(seed), free_field([source], azimuths_deg)
    windows = (field(rng, WINDOW_S, snr_db) for _ in range(count))
    return compare(windows, {'ours': ours(Localizer(PAIR, RATE, SETTINGS))})['ours']


def accuracy(count: int, sources: dict[str, Source]) -> Iterator[Figure]:
    """Errors over the full circle with mirror images folded, and what sigma and confidence say of them.

    The limits apply to rotors, except to those with equal power per octave at -10 dB: there the Cramer-Rao bound, which assumes
    a known spectrum, is 3 degrees.
    """
    limits, results = {10.0: 0.6, 0.0: 1.0, -5.0: 2.0, -10.0: 4.0}, []
    for name, source in sources.items():
        for snr_db in (20.0, *limits):
            results.append(_trials(31, source, snr_db, count))
            limited = name == 'bright rotors' or (name == 'rotors' and snr_db > -10.0)
            yield from error_figures(f'{name}, {snr_db:+.0f} dB', results[-1],
                                     {'RMSE': limits[snr_db]} if limited and snr_db in limits else {})
        masked = _trials(35, source, -20.0, count)
        yield Figure(f'{name}, -20 dB: share above the default confidence', share(masked.passed), '%', 2.0)
    together = Trials.together(results)
    yield Figure('all sources, +20 to -10 dB: errors within 1.64 sigma', together.coverage, '%', 97.0, 85.0)
    yield Figure('all sources, +20 to -10 dB: errors above 20 deg', share(together.far[together.passed]), '%', 1.0)


def bound(count: int) -> Iterator[Figure]:
    """RMSE over the Cramer-Rao bound (Knapp and Carter, 1976) for a flat source at 30 to 150 degrees from the axis."""
    low, high = BAND_HZ
    for snr_db in (20.0, 10.0, 0.0):
        result = _trials(33, flat, snr_db, count, (-60.0, 60.0))
        snr = 10.0 ** (snr_db / 10.0)
        delay = np.sqrt(3.0 * (1.0 + 2.0 * snr) / (8.0 * np.pi**2 * WINDOW_S * snr**2 * (high**3 - low**3)))
        bounds = C * delay / (PAIR.aperture * np.cos(np.radians(np.linspace(-60.0, 60.0, 1001))))
        ratio = rmse(result.error) / float(np.degrees(rmse(bounds)))
        yield Figure(f'flat source, {snr_db:+.0f} dB: RMSE over Cramer-Rao bound', ratio, '', 1.3)


def cost() -> Iterator[Figure]:
    """Processor time of the stage of doa_node as shipped, with two sources, for one thread with OMP_NUM_THREADS=1."""
    rng, settings = np.random.default_rng(72), LocalizerSettings()
    for array in ARRAYS:
        sound = sum((rotors(rng, COST_S, -array.positions @ angles_to_direction(azimuth) / C) for azimuth in (-0.7, 0.5)),
                    np.zeros((round(COST_S * RATE), array.channels)))
        stage, block = DoaStage(array, settings, drone_model=load_model('')), round(settings.hop_s * RATE)
        frames = [audio_frame(part.astype(np.float32), block * k, RATE, Header(stamp=to_stamp(1.0 + block * k / RATE)))
                  for k, part in enumerate(np.split(add_noise(rng, sound, 15.0), round(COST_S * RATE / block)))]
        begun = process_time()
        for k, frame in enumerate(frames):
            stage.on_audio(frame, 1.0 + block * (k + 1) / RATE)
        yield Figure(f'{array.name}: of a core', 100.0 * (process_time() - begun) / COST_S, '%')
