"""The localizer against sources whose delays are known in closed form."""

import numpy as np
import pytest
from known_sound import RATE, add_noise, flat

from av_audio import DOA_METHODS, Localizer, LocalizerSettings
from av_common.acoustics import speed_of_sound
from av_common.angles import angles_to_direction, wrap
from av_common.microphone_array import DelayCurve, MicrophoneArray

PAIR = MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]], 'pair')
SQUARE = MicrophoneArray([[0.03, 0.03, 0.0], [-0.03, 0.03, 0.0], [-0.03, -0.03, 0.0], [0.03, -0.03, 0.0]], 'square')


def plane_wave(array, azimuth_deg, elevation_deg=0.0, seconds=0.5, noise=0.05, seed=0, temperature_c=20.0):
    """Sinusoids of 200 to 4000 Hz whose phases follow from the geometry, plus white noise (n, m)."""
    rng = np.random.default_rng(seed)
    direction = angles_to_direction(np.radians(azimuth_deg), np.radians(elevation_deg))
    sound = flat(rng, seconds, -array.positions @ direction / speed_of_sound(temperature_c))
    return 0.1 * sound / sound.std() + 0.1 * noise * rng.normal(size=sound.shape)


def only(estimates):
    assert len(estimates) == 1
    return estimates[0]


@pytest.mark.parametrize('method', DOA_METHODS.names)
@pytest.mark.parametrize('azimuth', [-80.0, -35.0, 0.0, 12.3, 61.0])
def test_two_microphones_give_both_mirror_images(method, azimuth):
    settings = LocalizerSettings(method=method, hop_s=1.0)
    estimate = only(Localizer(PAIR, RATE, settings).process(plane_wave(PAIR, azimuth), 0))
    np.testing.assert_allclose(np.degrees(wrap(estimate.azimuth - np.radians([azimuth, 180.0 - azimuth]))), 0.0,
                               atol=2.0 if method in ('music', 'mvdr') else 0.3)
    assert estimate.group.tolist() == [0, 0]
    assert np.all(estimate.confidence > 0.99)
    assert np.all(np.isinf(estimate.elevation_variance))
    assert np.degrees(np.sqrt(estimate.azimuth_variance[0])) < (2.0 if method in ('music', 'mvdr') else 0.6)


def test_a_source_on_the_axis_is_marked_as_end_fire():
    estimate = only(Localizer(PAIR, RATE, LocalizerSettings(hop_s=1.0)).process(plane_wave(PAIR, 90.0), 0))
    assert estimate.end_fire.all()
    np.testing.assert_allclose(np.degrees(estimate.azimuth), 90.0, atol=3.0)
    beside = only(Localizer(PAIR, RATE, LocalizerSettings(hop_s=1.0)).process(plane_wave(PAIR, 0.0), 0))
    assert not beside.end_fire.any()
    assert estimate.azimuth_variance[0] > 10.0 * beside.azimuth_variance[0]


@pytest.mark.parametrize('array', [
    MicrophoneArray([[0.1, 0.0, 0.0], [-0.05, 0.087, 0.0], [-0.05, -0.087, 0.0]]),
    MicrophoneArray(0.05 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]))], ids=['triangle', 'tetrahedron'])
def test_a_direction_along_which_nothing_agrees_has_no_confidence(array):
    """One microphone hears noise alone: what is left tells a cone, or two mirror images."""
    localizer, confident = Localizer(array, RATE, LocalizerSettings(hop_s=0.5)), 0
    for seed in range(20):
        sound = plane_wave(array, 18.0 * seed, 10.0, noise=0.3, seed=seed)
        sound[:, 1] = 0.1 * np.random.default_rng(100 + seed).normal(size=len(sound))
        confident += only(localizer.process(sound, localizer.next_sample)).confidence.max() >= 0.9
    assert confident <= 1


def test_a_line_that_is_bent_by_two_millimetres_is_a_line():
    """Positions as measured by a ruler: what the bend tells of sides is less than what sound and positions err by."""
    bent = MicrophoneArray([[0.0, 0.075, 0.0], [0.002, 0.025, 0.0], [0.0, -0.025, 0.0], [0.0, -0.075, 0.0]])
    for seed, (azimuth, elevation) in enumerate([(20.0, 0.0), (-50.0, 30.0), (150.0, 10.0), (65.0, 40.0), (-170.0, 20.0)]):
        sound = plane_wave(bent, azimuth, elevation, noise=0.5, seed=seed)
        estimate = only(Localizer(bent, RATE, LocalizerSettings(hop_s=1.0)).process(sound, 0))
        assert len(estimate.azimuth) == 2
        true = (angles_to_direction(np.radians(azimuth), np.radians(elevation)) @ bent.basis[:, 0])
        assert np.degrees(abs(np.arccos(estimate.cosine) - np.arccos(true))) < 2.0


def test_a_ring_with_a_microphone_two_millimetres_up_is_a_plane():
    turns = np.arange(6) * np.pi / 3.0
    positions = np.stack([0.046 * np.cos(turns), 0.046 * np.sin(turns), 0.0 * turns], axis=1)
    positions[0, 2] = 0.002
    ring = MicrophoneArray(positions)
    for seed, (azimuth, elevation) in enumerate([(20.0, 30.0), (-50.0, 45.0), (150.0, 20.0)]):
        sound = plane_wave(ring, azimuth, elevation, noise=1.5, seed=seed)
        estimate = only(Localizer(ring, RATE, LocalizerSettings(hop_s=1.0)).process(sound, 0))
        assert abs(np.degrees(wrap(estimate.azimuth[0] - np.radians(azimuth)))) < 1.0
        assert np.degrees(estimate.elevation[0]) == pytest.approx(elevation, abs=2.0)


@pytest.mark.parametrize('azimuth, elevation', [(0.0, 10.0), (77.0, 45.0), (-135.0, 20.0), (180.0, 5.0)])
def test_a_square_tells_the_full_circle_and_elevation(azimuth, elevation):
    sound = plane_wave(SQUARE, azimuth, elevation)
    estimate = only(Localizer(SQUARE, RATE, LocalizerSettings(hop_s=1.0)).process(sound, 0))
    assert len(estimate.azimuth) == 1
    assert abs(np.degrees(wrap(estimate.azimuth[0] - np.radians(azimuth)))) < 0.5
    assert np.degrees(estimate.elevation[0]) == pytest.approx(elevation, abs=1.0)
    both = Localizer(SQUARE, RATE, LocalizerSettings(hop_s=1.0, elevation_deg=(-90.0, 90.0))).process(sound, 0)[0]
    np.testing.assert_allclose(np.degrees(both.elevation), [elevation, -elevation], atol=1.0)


@pytest.mark.parametrize('scale', [1.0, 0.97])
def test_the_elevation_at_the_horizon_is_uncertain_also_by_positions_that_are_too_small(scale):
    """Of a square that is 3 % larger than stated no direction has the delays: its variance of the elevation was 0."""
    stated = MicrophoneArray(scale * SQUARE.positions)
    estimate = only(Localizer(stated, RATE, LocalizerSettings(hop_s=1.0)).process(plane_wave(SQUARE, 20.0), 0))
    assert 1.0 < np.degrees(np.sqrt(estimate.elevation_variance[0])) < 20.0
    assert np.degrees(np.sqrt(estimate.azimuth_variance[0])) < 1.0


def test_the_scatter_beside_an_ear_is_an_error_of_the_angle():
    """Paths of sources within 30 degrees of the axis scatter about the curve by 0.1 baselines: by 13 degrees, or to the end."""
    lateral = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 61)
    scatter = 0.1 * (np.abs(np.degrees(lateral)) > 50.0) + 0.005
    ears = MicrophoneArray(PAIR.positions, 'ears', DelayCurve(np.sin(lateral), 0.7 / 90.0 * np.degrees(lateral),
                                                              tuple(scatter.tolist())))
    rng, sigmas = np.random.default_rng(5), []
    for truth in np.linspace(60.0, 90.0, 60):
        path = 0.2 * (0.7 * truth / 90.0 + 0.1 * rng.normal())
        sound = flat(rng, 0.5, np.array([0.0, path]) / speed_of_sound(20.0))
        estimate = only(Localizer(ears, RATE).process(0.1 * sound / sound.std() + 1e-3 * rng.normal(size=sound.shape), 0))
        error = min(np.abs(np.degrees(estimate.azimuth) - truth))
        sigmas.append(error / np.degrees(np.sqrt(estimate.azimuth_variance[0])))
    assert np.mean(np.array(sigmas) < 1.0) > 0.5 and np.mean(np.array(sigmas) < 1.64) > 0.85


def test_temperature_scales_the_delay():
    sound = plane_wave(PAIR, 50.0, temperature_c=-20.0)
    estimate = only(Localizer(PAIR, RATE, LocalizerSettings(temperature_c=-20.0, hop_s=1.0)).process(sound, 0))
    assert np.degrees(estimate.azimuth[0]) == pytest.approx(50.0, abs=0.1)


@pytest.mark.parametrize('block', [160, 1600, 30011])
@pytest.mark.parametrize('hop', [0.05, 0.5, 0.7])
def test_windows_are_hop_apart_whatever_the_blocks(block, hop):
    sound = plane_wave(PAIR, 20.0, seconds=2.0)
    localizer = Localizer(PAIR, RATE, LocalizerSettings(hop_s=hop))
    times = [estimate.time for start in range(0, len(sound), block)
             for estimate in localizer.process(sound[start:start + block], start)]
    np.testing.assert_allclose(times, np.arange(0.25, 1.7501, hop))


def test_unusable_samples_restart_and_never_reach_an_estimate():
    sound = plane_wave(PAIR, 10.0, seconds=1.5)
    localizer = Localizer(PAIR, RATE, LocalizerSettings(hop_s=0.1))
    broken = sound.copy()
    broken[20_000, 1] = np.nan
    blocks = [localizer.process(broken[start:start + 1600], start) for start in range(0, len(broken), 1600)]
    estimates = [estimate for block in blocks for estimate in block]
    assert estimates[0].centre_sample == 20_800 + 12_000
    assert all(np.isfinite(estimate.azimuth).all() for estimate in estimates)


@pytest.mark.parametrize('decay', [0.0, 1.5], ids=['white noise', 'wind'])
def test_sound_that_differs_between_the_microphones_has_no_confidence(decay):
    rng = np.random.default_rng(3)
    localizer = Localizer(PAIR, RATE, LocalizerSettings(hop_s=0.5))
    shape = np.maximum(np.fft.rfftfreq(24_000, 1.0 / RATE), 5.0) ** -decay
    confident = 0
    for _ in range(300):
        noise = np.fft.irfft(np.fft.rfft(rng.normal(size=(2, 24_000)), axis=1) * shape, axis=1).T
        confident += only(localizer.process(0.1 * noise / noise.std(), localizer.next_sample)).confidence[0] > 0.9
    assert confident < 0.01 * 300


def test_level_is_that_of_the_band():
    time = np.arange(24_000) / RATE
    tone = 0.5 * np.sin(2.0 * np.pi * 1000.0 * time)[:, None] * np.ones(2)
    hum = 0.5 * np.sin(2.0 * np.pi * 50.0 * time)[:, None] * np.ones(2)
    localizer = Localizer(PAIR, RATE, LocalizerSettings(hop_s=1.0))
    assert only(localizer.process(tone, 0)).level_dbfs == pytest.approx(10.0 * np.log10(0.125), abs=0.3)
    assert only(localizer.process(hum, 0)).level_dbfs < -50.0


@pytest.mark.parametrize('settings, message', [
    ({'window_s': 0.0}, 'window_s=0.0'), ({'hop_s': -1.0}, 'hop_s=-1.0'), ({'method': 'magic'}, "method 'magic'"),
    ({'band_hz': (200.0, 30_000.0)}, 'half of the sample rate'), ({'band_hz': (4000.0, 200.0)}, 'band_low is 4000'),
    ({'band_hz': (300.0, 302.0), 'window_s': 10.0, 'method': 'phat'}, 'too narrow'),
    ({'band_hz': (300.0, 310.0), 'window_s': 10.0, 'method': 'mvdr'}, 'too narrow'),
    ({'elevation_deg': (50.0, 10.0)}, 'elevation_min_deg is 50'), ({'max_sources': 5}, 'max_sources=5')])
def test_bad_settings_say_what_is_wrong(settings, message):
    with pytest.raises(ValueError, match=message):
        Localizer(PAIR, RATE, LocalizerSettings(**settings))


@pytest.mark.parametrize('method', DOA_METHODS.names)
def test_arrays_far_smaller_than_a_wavelength_hear(method):
    """Of so few directions on the grid some have fewer neighbours than usual."""
    for positions in (SQUARE.positions, 0.005 * np.vstack([np.zeros(3), np.eye(3)])):
        array = MicrophoneArray(positions)
        settings = LocalizerSettings(method=method, band_hz=(100.0, 250.0), max_sources=4)
        assert len(only(Localizer(array, RATE, settings).process(plane_wave(array, 30.0), 0)).azimuth)


@pytest.mark.parametrize('positions', [2.0 * SQUARE.positions, [[0.0, y, 0.0] for y in (-0.15, -0.05, 0.03, 0.15)]])
def test_a_clear_source_below_1200_hz_has_confidence(positions):
    """As a drone far away, of which the air leaves low frequencies: most bands up to 8 kHz have nothing of it."""
    array, rng = MicrophoneArray(positions), np.random.default_rng(11)
    errors, confidences = [], []
    for azimuth in rng.uniform(-1.0, 1.0, 12):
        sound = flat(rng, 0.5, -array.positions @ angles_to_direction(azimuth) / speed_of_sound(20.0), (60.0, 1200.0), 0.5)
        estimate, = Localizer(array, RATE, LocalizerSettings(hop_s=0.5)).process(add_noise(rng, sound, 15.0), 0)
        errors.append(np.abs(wrap(estimate.azimuth - azimuth)).min())
        confidences.append(estimate.confidence.max())
    assert np.degrees(np.max(errors)) < 5.0
    assert np.mean(np.array(confidences) >= 0.9) > 0.8
