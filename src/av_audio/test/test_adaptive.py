"""The default method in fields that contradict its likelihood: reflections, sound outside of the band, short windows."""

import numpy as np
import pytest

from av_audio import Localizer, LocalizerSettings
from av_common.acoustics import speed_of_sound
from av_common.angles import wrap
from av_common.microphone_array import MicrophoneArray

PAIR = MicrophoneArray([[0.0, 0.08, 0.0], [0.0, -0.08, 0.0]])
C = speed_of_sound(20.0)
RATE = 24_000
REFLECTIONS = 40
DECAY_S = 0.06    # of the power of reflections, by 1 / e
PAD_S = 0.4


def waves(rng, cosines, delays, gains, seconds, band_hz=(100.0, 10_000.0)):
    """Noise in a band that arrives as plane waves with cosines, delays (s) and gains (w,); exact, by phase shifts."""
    count = round((seconds + PAD_S) * RATE)
    frequencies = np.fft.rfftfreq(count, 1.0 / RATE)
    inside = (frequencies > band_hz[0]) & (frequencies < band_hz[1])
    spectrum = np.where(inside, rng.normal(size=inside.size) + 1j * rng.normal(size=inside.size), 0.0)
    sound = []
    for place in PAIR.positions[:, 1]:
        shifts = delays - place * cosines / C
        transfer = sum(gain * np.exp(-2j * np.pi * frequencies * shift) for gain, shift in zip(gains, shifts, strict=True))
        sound.append(np.fft.irfft(spectrum * transfer, count)[-round(seconds * RATE):])
    sound = np.array(sound).T
    return 0.05 * sound / sound.std()


def reverberant(rng, azimuth, seconds):
    """Direct sound with as much power in reflections that follow it by 1 ms or more."""
    delays = np.concatenate([[0.0], 0.001 + rng.exponential(DECAY_S, REFLECTIONS)])
    cosines = np.concatenate([[np.sin(azimuth)], rng.uniform(-1.0, 1.0, REFLECTIONS)])
    reflected = rng.choice([-1.0, 1.0], REFLECTIONS) * np.exp(-0.5 * delays[1:] / DECAY_S)
    gains = np.concatenate([[1.0], reflected / np.sqrt(np.sum(reflected**2))])
    return waves(rng, cosines, np.minimum(delays, PAD_S), gains, seconds)


def located(sound, **settings):
    seconds = len(sound) / RATE
    estimate, = Localizer(PAIR, RATE, LocalizerSettings(window_s=seconds, hop_s=seconds, **settings)).process(sound, 0)
    return estimate


def error_deg(estimate, azimuth):
    return float(np.degrees(np.min(np.abs(wrap(estimate.azimuth - azimuth)))))


@pytest.mark.parametrize('seconds', [0.5, 0.1])
def test_reflections_shift_it_less_than_the_likelihood_and_sigma_says_so(seconds):
    rng = np.random.default_rng(1)
    rows = []
    for azimuth in rng.uniform(-1.2, 1.2, 40):
        sound = reverberant(rng, azimuth, seconds)
        estimate = located(sound)
        rows.append((error_deg(estimate, azimuth), np.degrees(np.sqrt(estimate.azimuth_variance[0])), estimate.confidence[0],
                     error_deg(located(sound, method='plain'), azimuth), error_deg(located(sound, method='phat'), azimuth)))
    error, sigma, confidence, plain, phat = np.array(rows).T
    assert np.median(error) < 0.7 * np.median(plain) and np.median(error) < 1.05 * np.median(phat)
    passed = confidence >= 0.9
    assert passed.mean() > 0.3
    assert np.mean(error[passed] > 20.0) < 0.05
    assert np.mean(error[passed] < 1.64 * sigma[passed]) > 0.8


def test_sound_above_the_band_is_located():
    rng = np.random.default_rng(2)
    azimuth = np.radians(35.0)
    high = waves(rng, np.array([np.sin(azimuth)]), np.zeros(1), np.ones(1), 0.5, (5500.0, 7500.0))
    sound = high + 0.005 * rng.normal(size=high.shape)
    assert error_deg(located(sound), azimuth) < 1.0
    assert located(sound, method='phat').confidence[0] < 0.5


def test_noise_without_reflections_is_left_to_the_likelihood():
    rng = np.random.default_rng(3)
    errors = []
    for azimuth in rng.uniform(-1.0, 1.0, 40):
        sound = waves(rng, np.array([np.sin(azimuth)]), np.zeros(1), np.ones(1), 0.5, (200.0, 4000.0))
        sound += 0.05 * rng.normal(size=sound.shape)    # 8 dB below it inside the band
        errors.append([error_deg(located(sound, method=method), azimuth) for method in ('ml', 'phat')])
    ours, phat = np.sqrt(np.mean(np.square(errors), axis=0))
    assert ours < phat


@pytest.mark.parametrize(('rate', 'band'), [(8000, (200.0, 3500.0)), (16_000, (200.0, 4000.0)), (192_000, (500.0, 20_000.0))])
def test_any_rate_and_band(rate, band):
    rng = np.random.default_rng(4)
    sound = np.repeat(rng.normal(0.0, 0.05, (rate // 2, 1)), 2, axis=1)
    estimate, = Localizer(PAIR, rate, LocalizerSettings(band_hz=band, hop_s=1.0)).process(sound, 0)
    assert error_deg(estimate, 0.0) < 0.01


@pytest.mark.parametrize('kind', ['noise', 'tone', 'click'])
@pytest.mark.parametrize('level', [1.0, 0.37, 0.1])
def test_channels_that_are_copies_have_a_finite_direction(kind, level):
    """Nothing disagrees, so that each estimate may expect no error at all: the source is broadside."""
    time = np.arange(RATE // 2) / RATE
    sound = {'noise': np.random.default_rng(3).normal(size=len(time)), 'tone': np.sin(2.0 * np.pi * 440.0 * time),
             'click': np.where(np.arange(len(time)) == 5000, 1.0, 0.0)}[kind]
    estimate = located(np.stack([level * sound] * 2, axis=1))
    assert error_deg(estimate, 0.0) < 0.1 and np.isfinite(estimate.azimuth_variance).all()
