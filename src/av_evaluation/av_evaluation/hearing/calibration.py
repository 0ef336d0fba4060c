"""Calibration of a pair: at a head, and with a share of wrong estimates against the same without."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy import signal

from av_audio.calibration import SEARCH_STRETCH, Calibration, calibrate, measured_path, search_array
from av_audio.calibration_report import Verdict, judge
from av_audio.localizer import Localizer, LocalizerSettings
from av_common.angles import angles_to_direction, wrap
from av_common.microphone_array import MicrophoneArray
from av_evaluation.figures import Figure
from av_evaluation.hearing.free_field import azimuth_error, rms
from av_evaluation.hearing.places import EARS, LARGEST_ORDER, SPACING_M, at_ears, calibrated_ears, pair, read_responses, shoebox
from av_evaluation.hearing.signals import RATE, Source, add_noise, load_clip

SHARES = (0.1, 0.3, 0.45)    # of wrong estimates
WORSE = 1.2    # factor by which the result may be worse with 30 % of them
DRAWS = 5    # of wrong estimates per recording
AZIMUTHS = 36
T60_S, DISTANCE_M = (0.2, 0.4), (1.0, 2.0)    # where one walks around a rig with a loudspeaker
DWELL_S, SETTLED_S, SNR_DB = 1.0, 0.5, 20.0
ASIDE_DEG = 70.0    # from broadside, up to which curves are compared

# A recording: the array, true azimuths (n,) in rad and measured path differences (n,) in m; and the true path of an azimuth.
Recording = tuple[MicrophoneArray, NDArray, NDArray, Callable[[NDArray], NDArray]]


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
                   at_ears(clip[5 * rate:7 * rate], responses[k]), 0)]
    truth, errors = np.array(results).T
    yield Figure('KEMAR, |azimuth| <= 60 deg: mean error', float(errors[np.abs(truth) <= 60.0].mean()), 'deg', 1.5)
    yield Figure('KEMAR, all azimuths, folded: mean error', errors.mean(), 'deg', 3.0)
    yield Figure('KEMAR, all azimuths, folded: RMSE', rms(errors), 'deg')
    yield Figure('KEMAR, all azimuths, folded: errors above 20 deg', 100.0 * np.mean(errors > 20.0), '%')
    yield Figure('KEMAR, all azimuths, folded: largest error', errors.max(), 'deg')


def outliers(rooms: int, source: Source, data: Path) -> Iterator[Figure]:
    """RMS error of calibrated curves by share of wrong estimates, relative to that without, and how many get which verdict.

    Parameters:
        rooms: number of rooms.
        source: generator of sound.
        data: folder with the measured responses of a head.
    """
    rng = np.random.default_rng(71)
    recordings = {'rooms': [_in_room(rng, source) for _ in range(rooms)], 'head': [_at_head(rng, source, data)]}
    for name, recorded in recordings.items():
        for kind, wrong in (('anywhere', _anywhere), ('one reflection', _reflection)):
            clean = rms(np.array([_error_deg(calibrate(*one[:3]), one) for one in recorded]))
            yield Figure(f'{name}: RMS error without wrong estimates', clean, 'deg')
            for share in SHARES:
                errors, verdicts = _with_wrong(rng, recorded, share, wrong)
                label = f'{name}, {100.0 * share:.0f} % wrong, {kind}'
                yield Figure(f'{label}: RMS error over that without', rms(errors) / clean, '', WORSE if share <= 0.3 else None)
                for verdict in sorted(verdicts):
                    yield Figure(f'{label}: {verdict.name.lower().replace("_", " ")} (exit code {verdict})',
                                 100.0 * verdicts[verdict] / verdicts.total(), '%')


def _with_wrong(rng: Generator, recorded: list[Recording], share: float, wrong: Callable[[Generator, int, float], NDArray]
                ) -> tuple[NDArray, Counter[Verdict]]:
    """Errors in deg and verdicts of DRAWS calibrations of each recording with a share of wrong paths."""
    errors, verdicts = list[float](), Counter[Verdict]()
    for array, azimuths, paths, true_path in recorded:
        for _ in range(DRAWS):
            spoilt = paths.copy()
            chosen = rng.permutation(len(paths))[:round(share * len(paths))]
            spoilt[chosen] = wrong(rng, len(chosen), SEARCH_STRETCH * array.aperture)
            calibration = calibrate(array, azimuths, spoilt)
            errors.append(_error_deg(calibration, (array, azimuths, paths, true_path)))
            verdicts[judge(calibration).verdict] += 1
    return np.array(errors), verdicts


def _anywhere(rng: Generator, count: int, longest: float) -> NDArray:
    """Path differences of estimates that have nothing to do with the source."""
    return rng.uniform(-longest, longest, count)


def _reflection(rng: Generator, count: int, longest: float) -> NDArray:
    """Path differences of a wall from which all wrong estimates seem to come."""
    return rng.uniform(-0.6, 0.6) * longest / SEARCH_STRETCH + 0.005 * rng.normal(size=count)


def _error_deg(calibration: Calibration, recording: Recording) -> float:
    """RMS error of angles that the calibrated array gives for true paths up to ASIDE_DEG from broadside."""
    azimuths = np.radians(np.linspace(-ASIDE_DEG, ASIDE_DEG, 57))
    array, curve = calibration.array, calibration.array.delay_curve
    assert curve is not None    # of every calibration
    axis = np.arctan2(array.basis[1, 0], array.basis[0, 0])
    found = axis - np.arccos(np.clip(curve.true_cosine(recording[3](azimuths) / array.aperture), -1.0, 1.0))
    return float(np.degrees(rms(found - azimuths)))


def _in_room(rng: Generator, source: Source) -> Recording:
    """A loudspeaker at AZIMUTHS places around a pair in a random room of pyroomacoustics."""
    array = pair(rng.uniform(*SPACING_M))
    while True:
        size, t60, distance = rng.uniform([5.0, 5.0, 2.5], [10.0, 9.0, 4.0]), rng.uniform(*T60_S), rng.uniform(*DISTANCE_M)
        try:
            room = shoebox(size, t60, LARGEST_ORDER)
            break
        except ValueError:
            continue
    place = rng.uniform([2.3, 2.3, 1.0], [size[0] - 2.3, size[1] - 2.3, 1.5])
    room.add_microphone_array((place + array.positions).T)
    azimuths = np.linspace(-np.pi, np.pi, AZIMUTHS, endpoint=False)
    for azimuth in azimuths:
        room.add_source(place + distance * angles_to_direction(azimuth))
    room.compute_rir()
    responses = [[microphone[k] for microphone in room.rir] for k in range(AZIMUTHS)]

    def true_path(angles: NDArray) -> NDArray:
        away = distance * angles_to_direction(angles)[:, None] - array.positions
        return np.linalg.norm(away, axis=-1) @ np.array([-1.0, 1.0])

    return _recording(rng, source, array, azimuths, responses, RATE, true_path)


def _at_head(rng: Generator, source: Source, data: Path) -> Recording:
    """A source around the measured ears of KEMAR; the true path is that of white noise."""
    azimuths, responses, rate = read_responses(data / 'kemar' / 'mit_kemar_normal_pinna.sofa')

    def hiss(rng: Generator, seconds: float, delays: NDArray) -> NDArray:
        return rng.normal(size=(round(seconds * RATE), 1))

    _, angles, paths, _ = _recording(rng, hiss, EARS, azimuths, list(responses), rate, np.sin)
    order = np.argsort(np.arcsin(np.sin(angles)))
    front = order[np.cos(angles[order]) > 0.0]
    return _recording(rng, source, EARS, azimuths, list(responses), rate,
                      lambda wanted: np.interp(wanted, np.arcsin(np.sin(angles[front])), paths[front]))


def _recording(rng: Generator, source: Source, array: MicrophoneArray, azimuths: NDArray, responses: list[list[NDArray]],
               rate: int, true_path: Callable[[NDArray], NDArray]) -> Recording:
    """Path differences that are measured of a source at azimuths (k,), by responses (2, taps) of each, at a rate in Hz."""
    found, common = list[tuple[float, float]](), np.gcd(rate, RATE)
    for azimuth, response in zip(azimuths, responses, strict=True):
        dry = signal.resample_poly(source(rng, SETTLED_S + DWELL_S, np.zeros(1))[:, 0], rate // common, RATE // common)
        wet = at_ears(dry, response)[-round(DWELL_S * rate):]
        localizer = Localizer(search_array(array), rate, LocalizerSettings(hop_s=0.25))
        try:
            found += [(azimuth, path) for path in measured_path(array, localizer.process(add_noise(rng, wet, SNR_DB), 0))[1]]
        except ValueError:    # no confident estimate at this place
            continue
    return (array, *np.array(found).T, true_path)
