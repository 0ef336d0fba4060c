"""Whether the parameters of doa_node let it hear, by what they do to clean sound and to the processor."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from std_msgs.msg import Header

from av_audio.drone_classifier import load_model
from av_audio.estimators import METHODS
from av_audio.localizer import LocalizerSettings
from av_audio.messages import audio_frame
from av_audio.stage import DoaStage, localizer_settings
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction
from av_common.microphone_array import MicrophoneArray

# A direction counts for this long since the centre of its window, in fusion's states and for what moves a body; a tenth of it
# is left for its way.
COUNTS_S, WAY_S = 1.0, 0.1
USUAL_RATE = 48_000  # Hz, the default of audio_node; frames tell the true one later
# A slow or busy machine leaves windows out and hears on; a hop that none could compute by far is a mistake.
MOST_BEHIND = 10.0  # of the hop, that a window may take
WINDOWS = 3  # that are computed at most; the quickest counts, since the first one fills caches
LEAST_CONFIDENCE = 0.5  # of clean sound: with less it is rather taken for none
WIDER = 'expected a wider band, such as 200 to 4000 Hz, or a longer window'
AZIMUTH = np.radians(40.0)  # of the sound, neither an axis nor a normal of an array


def check_ages(window: float, hop: float) -> None:
    """Raise ValueError where directions are too old before the next one comes: by their stamps nothing would be heard.

    Parameters:
        window, hop (s): parameters of doa_node.
    """
    oldest, most = 0.5 * window + hop, COUNTS_S - WAY_S
    if oldest > most:
        name, value, right = (('hop', hop, most - 0.5 * window) if hop > 0.5 * window else
                              ('window', window, 2.0 * (most - hop)))
        raise ValueError(f'{name} is {value:g} s: with window {window:g} s and hop {hop:g} s a direction is {oldest:.2f} s old '
                         f'before the next one comes, but counts for {COUNTS_S:g} s only; expected at most {right:.2f} s')


def check_hearing(parameters: Any, array: MicrophoneArray) -> None:
    """Raise ValueError where clean sound has no confidence, or where directions take far longer than their hop to compute.

    Parameters:
        parameters: generated struct of doa_node.
        array: its microphones.
    """
    settings = localizer_settings(parameters)
    rate = max(USUAL_RATE, round(2.5 * settings.band_hz[1]))
    stage = DoaStage(array, settings, drone_model=load_model(parameters.drone_model))
    sound, costs = audio_frame(_clean_sound(array, settings, rate), 0, rate, Header()), list[float]()
    while len(costs) < WINDOWS and min(costs, default=np.inf) > MOST_BEHIND * settings.hop_s:
        stage.reset()
        began = time.thread_time()
        try:
            stage.on_audio(sound, 0.0)
        except ValueError as error:
            raise ValueError(f'{_band(settings)}: {error}; {WIDER}') from error
        costs.append(time.thread_time() - began)
    if min(costs) > MOST_BEHIND * settings.hop_s:
        raise ValueError(f'hop is {settings.hop_s:g} s, but a window of {settings.window_s:g} s takes {min(costs):.4f} s of '
                         f'one processor here; expected more, such as {max(0.1, round(3.0 * min(costs), 1)):g} s')
    confidence = max(stage.latest.confidence, default=0.0) if stage.latest is not None else 0.0
    if settings.method in METHODS and confidence < LEAST_CONFIDENCE:
        raise ValueError(f'{_band(settings)}: even clean sound has a confidence of {confidence:.2f}; {WIDER}')


def _band(settings: LocalizerSettings) -> str:
    low, high = settings.band_hz
    return (f'band_low is {low:g} Hz and band_high {high:g} Hz, of which a window of {settings.window_s:g} s tells '
            f'{(high - low) * settings.window_s:.1f} frequencies apart')


def _clean_sound(array: MicrophoneArray, settings: LocalizerSettings, rate: int) -> NDArray[np.float32]:
    """One window (n, channels) of white noise alone, at `rate` (Hz), from within the elevations."""
    count, elevation = round(settings.window_s * rate), np.radians(np.mean(settings.elevation_deg))
    lead = array.positions @ angles_to_direction(AZIMUTH, elevation) / speed_of_sound(settings.temperature_c)
    frequencies = fft.rfftfreq(2 * count, 1.0 / rate)
    spectrum = fft.rfft(0.1 * np.random.default_rng(1).standard_normal(2 * count))
    sound = fft.irfft(spectrum * np.exp(2j * np.pi * frequencies * lead[:, None]))
    return sound[:, count // 2:count // 2 + count].T.astype(np.float32)
