"""What a recording of the rig alone is good for: decibels it buys, and at which level of own noise the rig is deaf."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_audio.ego_noise import MIN_DURATION_S, NoiseRecording
from av_audio.localizer import Localizer, LocalizerSettings
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction, wrap
from av_common.microphone_array import MicrophoneArray

LEVELS_DB = tuple(range(-10, 41, 5))  # of own noise over a target within the band
WINDOWS = 12  # judged at each level
WRONG_RAD = np.radians(20.0)  # as in all reports of errors: `OUTLIER_DEG` of av_evaluation
FEW, HALF = 0.1, 0.5  # shares of wrong windows up to which a target is heard, and from which the rig is deaf
PIECE_S = 1.0  # every other one is known, the rest is judged: all throttles are in both


class Verdict(NamedTuple):
    """Levels of own noise over a target, within the band.

    Parameters:
        heard_db (dB): up to which nine of ten directions are within 20 deg, with the recording; -inf for none.
        without_db (dB): the same without it.
        deaf_db (dB): from which half of the directions are wrong all the same; inf beyond all that was tried.
    """

    heard_db: float
    without_db: float
    deaf_db: float

    @property
    def gain_db(self) -> float:
        """What the recording buys in dB; at least 0."""
        lowest = LEVELS_DB[0] - 5.0
        return max(0.0, max(self.heard_db, lowest) - max(self.without_db, lowest))

    def words(self) -> str:
        """A line to read."""
        if not np.isfinite(self.heard_db):
            return f'the rig is deaf: with own noise at {LEVELS_DB[0]} dB over a target a tenth of the directions is wrong'
        deaf = f'deaf from {self.deaf_db:.0f} dB on' if np.isfinite(self.deaf_db) else f'not yet deaf at {LEVELS_DB[-1]} dB'
        return (f'the recording buys {self.gain_db:.0f} dB: targets are heard under own noise that is up to '
                f'{self.heard_db:.0f} dB louder; {deaf}')


def judge(recording: NoiseRecording, array: MicrophoneArray) -> Verdict:
    """Hear targets from all sides under one half of the recording, with the other half as what is known of the rig.

    Parameters:
        recording: of the rig alone.
        array: positions of the microphones.

    Raises ValueError for a recording that does not fit the array or is too short.
    """
    settings = LocalizerSettings()
    rate, rng = recording.sample_rate, np.random.default_rng(0)    # of the targets, which are noise within the band
    if len(recording.samples) < 2.0 * MIN_DURATION_S * rate:
        raise ValueError(f'{recording.name} lasts {len(recording.samples) / rate:.1f} s, expected {2.0 * MIN_DURATION_S:g} s '
                         'or more: one half rates the other')
    recording.check(array.channels, rate)
    pieces = np.array_split(recording.samples, max(2, round(len(recording.samples) / (PIECE_S * rate))))
    known = recording._replace(samples=np.concatenate(pieces[::2]))
    heard = recording._replace(samples=np.concatenate(pieces[1::2]))
    localizers = [Localizer(array, rate, settings, each) for each in (known, None)]
    windows = heard.windows(round(settings.window_s * rate))
    wrong = np.array([[_wrong(localizers, windows[k % len(windows)], level, settings, rng) for k in range(WINDOWS)]
                      for level in LEVELS_DB]).mean(axis=1)  # (levels, with and without)
    deaf = [float(level) for level, share in zip(LEVELS_DB, wrong[:, 0], strict=True) if share >= HALF]
    return Verdict(_last(wrong[:, 0] <= FEW), _last(wrong[:, 1] <= FEW), min(deaf, default=np.inf))


def _last(heard: NDArray) -> float:
    """Level up to which all are heard."""
    count = len(heard) if heard.all() else int(np.argmin(heard))
    return float(LEVELS_DB[count - 1]) if count else -np.inf


def _wrong(localizers: list[Localizer], own: NDArray, level_db: float, settings: LocalizerSettings, rng: np.random.Generator
           ) -> list[bool]:
    """Whether each localizer hears a target at a wrong place under own noise (m, n) that is louder by a level."""
    array, rate, count = localizers[0].array, localizers[0].sample_rate, own.shape[1]
    frequencies = np.fft.rfftfreq(count, 1.0 / rate)
    inside = (frequencies >= settings.band_hz[0]) & (frequencies <= settings.band_hz[1])
    azimuth = float(rng.uniform(-np.pi, np.pi))
    delays = -array.positions @ angles_to_direction(azimuth) / speed_of_sound(settings.temperature_c)
    noise = inside * (rng.normal(size=len(inside)) + 1j * rng.normal(size=len(inside)))
    target = np.fft.irfft(noise * np.exp(-2j * np.pi * np.outer(delays, frequencies)), count, axis=1)
    power = np.sum(np.abs(np.fft.rfft(own, axis=1)[:, inside]) ** 2) / array.channels
    target *= np.sqrt(power / np.sum(np.abs(noise) ** 2)) * 10.0 ** (-0.05 * level_db)
    found = []
    for localizer in localizers:
        estimate = localizer.process((own + target).T, localizer.next_sample + count)[0]  # a gap: no window mixes two
        found.append(not np.any(np.abs(wrap(estimate.azimuth - azimuth)) < WRONG_RAD))
    return found
