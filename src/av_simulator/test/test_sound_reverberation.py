"""Late reverberation: decay, level, density, zones, and the convolution behind it."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from av_simulator.sound import FormulaSignal, Medium, Noise, ReverbZone, SoundWorld, Source, Surroundings
from av_simulator.sound.reverberation import Answer, MovingConvolution, impulse_response

RATE = 16000
PAIR = np.array([[0.0, 0.1, 1.0], [0.0, -0.1, 1.0]])
HALL = {'minimum': (-20.0, -20.0, 0.0), 'maximum': (20.0, 20.0, 10.0)}


def decay_time(answer):
    """Time of 60 dB from the fall between -5 and -35 dB of the backward integral (ISO 3382-1)."""
    left = 10 * np.log10(np.cumsum(answer[::-1] ** 2)[::-1] / np.sum(answer**2))
    first, last = np.argmax(left < -5), np.argmax(left < -35)
    return -60.0 / np.polyfit(np.arange(first, last) / RATE, left[first:last], 1)[0]


def answer_of(zone, **medium):
    return impulse_response(zone, RATE, Medium(**medium), PAIR, [4])


@pytest.mark.parametrize('decay_s', [0.3, 1.0, 2.5])
@pytest.mark.parametrize('diffusion', [0.0, 1.0])
def test_it_decays_in_the_stated_time(decay_s, diffusion):
    answer = answer_of(ReverbZone(**HALL, decay_s=decay_s, diffusion=diffusion), temperature_c=20, humidity_percent=50)
    low = sosfilt(butter(4, 1000, fs=RATE, output='sos'), answer[0])  # higher up the air swallows more
    assert decay_time(low) == pytest.approx(decay_s, rel=0.1)


def test_air_shortens_the_decay_of_high_frequencies():
    zone, medium = ReverbZone(**HALL, decay_s=2.0, diffusion=1.0), Medium(20, 20)
    band = butter(4, [5700, 6300], 'bandpass', fs=RATE, output='sos')
    high = sosfilt(band, answer_of(zone, temperature_c=20, humidity_percent=20)[0])
    absorbed = float(medium.absorption_db_per_m(np.array(6000.0))) * medium.speed_of_sound
    assert decay_time(high) == pytest.approx(60.0 / (60.0 / 2.0 + absorbed), rel=0.1)


def test_its_energy_is_sabines_unless_stated():
    zone = ReverbZone(**HALL, decay_s=1.5)
    area = 0.161 * 40 * 40 * 10 / 1.5
    assert np.sum(answer_of(zone)[0] ** 2) == pytest.approx(16 * np.pi / area, rel=0.1)
    assert np.sum(answer_of(ReverbZone(**HALL, gain_db=-3.0))[0] ** 2) == pytest.approx(10**-0.3, rel=0.1)


def test_density_is_the_number_of_echoes_in_a_second():
    answer = answer_of(ReverbZone(**HALL, decay_s=2.0, density=40.0, diffusion=0.0), humidity_percent=90)[0]
    second = np.abs(answer[:RATE]) * 10 ** (3 * np.arange(RATE) / RATE / 2.0)
    peaks = (second[1:-1] > second[:-2]) & (second[1:-1] >= second[2:]) & (second[1:-1] > 0.4 * second.max())
    assert 25 < peaks.sum() < 60


def test_zone_answers_when_source_or_listener_is_inside():
    zone = ReverbZone(**HALL)
    inside, outside = np.array([[0.0, 0.0, 5.0]]), np.array([[30.0, 0.0, 5.0]])
    assert zone.weight(inside, inside) == 1.0
    assert zone.weight(inside, outside) == zone.weight(outside, inside) == pytest.approx(0.1)
    assert zone.weight(outside, outside) == 0.0


def test_flying_into_a_zone_starts_its_reverberation():
    signal = FormulaSignal(lambda t: np.random.default_rng(int(1e6 + 1000 * t[0])).standard_normal(len(t)))
    source = Source(lambda t: np.stack([60.0 - 20.0 * t, 0 * t, 0 * t + 5.0], axis=1), signal)

    def hear(zones):
        world = SoundWorld(RATE, [source], microphones=2, noise=Noise(None), surroundings=Surroundings(zones=zones))
        far = PAIR + np.array([0.0, 100.0, 0.0])
        return world.render(4 * RATE, np.array([far, far]))

    added = hear([ReverbZone(**HALL)]) - hear([])
    assert not added[:RATE].any()
    assert added[3 * RATE:].std() > 0.0


def test_at_one_place_it_is_convolution():
    random = np.random.default_rng(0)
    both, samples, places = random.standard_normal((2, 2, 1000)), random.standard_normal(3000), np.ones((1, 3000))
    answer = Answer.cut(both, 64, np.zeros((16, 1)), np.full(16, 0.7))
    whole = MovingConvolution(answer).process(samples, places)
    pieces = MovingConvolution(answer)
    cuts = [7, 300, 1111, 2000]
    cut = np.concatenate([pieces.process(part, np.ones((1, len(part)))) for part in np.split(samples, cuts)], axis=1)
    for channel in range(2):
        expected = np.convolve(samples, np.cos(0.7) * both[channel, 0] + np.sin(0.7) * both[channel, 1])[:3000 - 128]
        np.testing.assert_allclose(whole[channel, 128:], expected, atol=1e-4 * np.abs(expected).max())
    np.testing.assert_array_equal(whole, cut)


def test_places_are_answered_alike_when_they_are_near():
    """Over many parts the shares correlate as a Gaussian of the way of the source, or of the microphones."""
    answer = Answer.of(ReverbZone(**HALL, decay_s=2.0), RATE, Medium(), PAIR, 16, [1])
    here = answer.shares(np.zeros(9))
    assert np.sum(here**2, axis=1) == pytest.approx(1.0)
    for away in (0.05, 0.1, 0.2, 0.4):
        expected = pytest.approx(np.exp(-0.5 * (away / 0.1) ** 2), abs=0.06)
        assert np.mean(np.sum(here * answer.shares(np.eye(9)[1] * away), axis=1)) == expected
        both = np.array([0.0, 0.0, 0.0, away, 0.0, 0.0, away, 0.0, 0.0]) / np.sqrt(2.0)
        assert np.mean(np.sum(here * answer.shares(both), axis=1)) == expected


def test_the_room_does_not_answer_from_one_direction_for_ever():
    """A steady tone moves about: on average its tail is as alike at the microphones as a diffuse field, sin(kd) / (kd)."""
    tone = 1200.0
    signal = FormulaSignal(lambda t: np.sin(2 * np.pi * tone * t))
    source = Source(lambda t: np.stack([8.0 * np.sin(0.7 * t), 6.0 * np.cos(0.45 * t), 0 * t + 5.0], axis=1), signal)
    world = SoundWorld(RATE, [source], microphones=2, noise=Noise(None),
                       surroundings=Surroundings(zones=[ReverbZone(**HALL, decay_s=0.5, gain_db=60.0)]))
    heard = np.concatenate([world.render(RATE, np.array([PAIR, PAIR])) for _ in range(40)])[RATE:].T
    spectra = np.array([np.fft.rfft(heard[:, k:k + 800] * np.hanning(800)) for k in range(0, heard.shape[1] - 800, 400)])
    left, right = spectra[:, 0, 60], spectra[:, 1, 60]
    alike = np.mean(left * right.conj()) / np.sqrt(np.mean(np.abs(left) ** 2) * np.mean(np.abs(right) ** 2))
    distance = 2 * np.pi * tone / 343.2 * 0.2
    assert abs(alike - np.sin(distance) / distance) < 0.2  # one answer alone: 1


def test_no_direction_lasts_as_the_source_moves():
    """Over many places the answers of a room are as alike at two microphones as a diffuse field, sin(kd) / (kd)."""
    answer = Answer.of(ReverbZone(**HALL, decay_s=0.5), RATE, Medium(), PAIR, 160, [1])
    places = np.random.default_rng(2).uniform(-5.0, 5.0, (200, 9))
    cross, power = 0.0, 0.0
    for place in places:
        mixed = answer.shares(place)[..., None] * answer.spectra  # (m, pairs, 2, frequencies)
        left, right = np.stack([mixed[:, answer.parts == part].sum(axis=(1, 2)) for part in range(answer.parts.max() + 1)], 1)
        cross = cross + np.sum(left * right.conj(), axis=0)
        power = power + np.sum(np.abs(left) ** 2 + np.abs(right) ** 2, axis=0)
    frequencies = np.fft.rfftfreq(640, 1.0 / RATE)
    heard = (frequencies > 500.0) & (frequencies < 6000.0)
    unlike = (2.0 * cross / power - np.sinc(2.0 * 0.2 * frequencies / 343.2))[heard]
    assert np.sqrt(np.mean(np.abs(unlike) ** 2)) < 0.15


def test_impossible_zones_are_named():
    with pytest.raises(ValueError, match='zone minimum'):
        ReverbZone((0, 0, 0), (1, 1, 0))
