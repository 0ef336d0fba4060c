"""Motion within the analysis window, with sounds whose delays drift as truth."""

import numpy as np
import pytest
from known_sound import RATE, flat, heard

from av_audio import Localizer, LocalizerSettings, NoiseRecording
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction, wrap
from av_common.microphone_array import MicrophoneArray

PAIR = MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]], 'pair')
SQUARE = MicrophoneArray([[0.03, 0.03, 0.0], [-0.03, 0.03, 0.0], [-0.03, -0.03, 0.0], [0.03, -0.03, 0.0]], 'square')
PYRAMID = MicrophoneArray([[0.05, 0.0, 0.0], [-0.03, 0.04, 0.0], [-0.03, -0.04, 0.0], [0.0, 0.0, 0.06]])
SETTINGS = LocalizerSettings(hop_s=1.0)


def fading(array, azimuth_deg, elevation_deg, rate_deg, seconds=0.5, seed=0, noise=0.05, decades=1.0):
    """Noise (n, m) that loses decades of its amplitude within the window, from a direction that turns about the vertical."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(seconds * RATE)) / RATE - 0.5 * seconds
    azimuths = np.radians(azimuth_deg + rate_deg * times)
    towards = angles_to_direction(azimuths, np.full(len(times), np.radians(elevation_deg)))
    steady = flat(rng, seconds + 0.1, np.zeros(1))[:, 0]
    sound = heard(steady, times[:, None] + towards @ array.positions.T / speed_of_sound(20.0))
    sound *= (10.0 ** (-decades * times / seconds))[:, None] / sound.std()
    return 0.05 * (sound + noise * rng.normal(size=sound.shape))


def azimuth_deg(array, sound, settings=SETTINGS):
    estimate, = Localizer(array, RATE, settings).process(sound, 0)
    return np.degrees(estimate.azimuth[0]), np.degrees(np.sqrt(estimate.azimuth_variance[0]))


@pytest.mark.parametrize('rate', [-60.0, -40.0, -15.0, 15.0, 40.0, 60.0])
@pytest.mark.parametrize('azimuth', [-50.0, 10.0])
def test_a_sound_that_fades_gives_the_direction_at_the_centre(rate, azimuth):
    """Most of its energy comes 0.12 s before the centre: 7 deg away at 60 deg/s."""
    found, sigma = azimuth_deg(PAIR, fading(PAIR, azimuth, 0.0, rate))
    assert found == pytest.approx(azimuth, abs=0.3)
    assert sigma < 0.5


@pytest.mark.parametrize('rate', [-140.0, 110.0])
def test_a_rig_that_a_pilot_turns_has_directions(rate):
    """PX4 turns by up to 150 deg/s. Where 70 deg/s were searched, errors were 4 deg in the median."""
    azimuths = np.arange(-40.0, 41.0, 8.0)
    found = [azimuth_deg(PAIR, fading(PAIR, azimuth, 0.0, rate, seed=k, noise=0.3, decades=0.0))[0]
             for k, azimuth in enumerate(azimuths)]
    assert np.median(np.abs(found - azimuths)) < 1.0


def test_other_weights_follow_motion_too():
    for rate in (-40.0, 40.0):
        found, _ = azimuth_deg(PAIR, fading(PAIR, 10.0, 0.0, rate), LocalizerSettings(hop_s=1.0, method='phat'))
        assert found == pytest.approx(10.0, abs=2.0)    # 5 deg without


@pytest.mark.parametrize('array', [SQUARE, PYRAMID], ids=['square', 'pyramid'])
@pytest.mark.parametrize('azimuth, elevation', [(20.0, 10.0), (-110.0, 40.0)])
def test_planes_and_spaces_of_microphones_follow_motion(array, azimuth, elevation):
    estimate, = Localizer(array, RATE, SETTINGS).process(fading(array, azimuth, elevation, 40.0), 0)
    assert np.degrees(wrap(estimate.azimuth[0] - np.radians(azimuth))) == pytest.approx(0.0, abs=1.0)
    assert np.degrees(estimate.elevation[0]) == pytest.approx(elevation, abs=2.0)


@pytest.mark.parametrize('azimuth', [-75.0, 0.0, 35.0, 90.0])
def test_at_rest_the_whole_window_counts(azimuth):
    """A sound that fades at rest is as accurate as without a model of motion, and so is its sigma."""
    errors, sigmas = np.array([azimuth_deg(PAIR, fading(PAIR, azimuth, 0.0, 0.0, seed=seed)) for seed in range(10)]).T
    plain = [azimuth_deg(PAIR, fading(PAIR, azimuth, 0.0, 0.0, seed=seed), LocalizerSettings(hop_s=1.0, window_s=0.0625))
             for seed in range(10)]    # too short for motion
    assert np.median(np.abs(errors - azimuth)) < (3.0 if azimuth == 90.0 else 0.2)
    assert np.median(sigmas) < np.median([sigma for _, sigma in plain])


def test_a_source_that_passes_end_fire():
    """The cosine has its maximum there: the mean over the window is lower, by 3 deg of the angle."""
    for rate in (-40.0, 40.0):
        found, sigma = azimuth_deg(PAIR, fading(PAIR, 90.0, 0.0, rate))
        assert abs(wrap(np.radians(found - 90.0))) < np.radians(max(2.0, 2.0 * sigma))


@pytest.mark.parametrize('window', [0.02, 0.05, 0.1, 0.3, 1.0])
@pytest.mark.parametrize('band', [(200.0, 4000.0), (1000.0, 1800.0)])
def test_windows_of_every_length(window, band):
    settings = LocalizerSettings(window_s=window, hop_s=1.0, band_hz=band)
    found, sigma = azimuth_deg(PAIR, fading(PAIR, 20.0, 0.0, 10.0, seconds=window), settings)
    assert found == pytest.approx(20.0, abs=max(1.5, 3.0 * sigma)) and sigma < 10.0


def test_tones_and_pulses_stay_finite():
    times = np.arange(RATE // 2) / RATE
    tone = 0.3 * np.sin(2.0 * np.pi * 1000.0 * times)[:, None] * np.ones(2)
    pulse = np.zeros((RATE // 2, 2))
    pulse[5000:5040] = 0.5
    for sound in (tone, pulse, tone * (times < 0.1)[:, None]):
        estimate, = Localizer(PAIR, RATE, SETTINGS).process(sound, 0)
        assert np.all(np.isfinite(estimate.azimuth)) and np.all(estimate.azimuth_variance >= 0.0)


def test_the_rigs_own_noise_is_not_taken_for_a_source_at_rest():
    """It is louder than the target and stays at -43 deg, while the target moves.

    Whitened windows have no model of motion: the direction is that of most of the energy, 0.12 s before the centre.
    """
    rng = np.random.default_rng(8)
    own = flat(rng, 4.0, np.array([0.0, -4e-4]))
    recording = NoiseRecording((0.1 * own / own.std()).astype(np.float32), RATE)
    for rate in (-30.0, 30.0):
        noise = flat(rng, 0.5, np.array([0.0, -4e-4]))
        sound = fading(PAIR, -20.0, 0.0, rate, seed=3) + 0.04 * noise / noise.std()
        estimate, = Localizer(PAIR, RATE, SETTINGS, recording).process(sound, 0)
        assert np.degrees(estimate.azimuth[0]) == pytest.approx(-20.0 - 0.12 * rate, abs=1.0)
