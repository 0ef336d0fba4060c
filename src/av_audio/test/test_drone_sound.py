"""Is it a drone: features, steering, the model, and the probability that the stage puts into messages."""

from __future__ import annotations

import contextlib
import math
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
import soundfile
from scipy.signal import resample_poly
from scipy.stats import mannwhitneyu
from test_doa_stage import feed

from av_audio import DoaStage, DroneClassifier, load_model
from av_audio.drone_classifier import SourceSpectra
from av_audio.drone_features import LINE_CELLS, LINES, DroneFeatures, Segment, bin_frequencies
from av_audio.drone_model import FUNDAMENTALS, LAYERS, LOWEST_CELL, STEPS, DroneModel
from av_common.acoustics import speed_of_sound
from av_common.microphone_array import MicrophoneArray
from av_common.shipped import shipped_file

RATE, C = 16_000, speed_of_sound(20.0)
PAIR = MicrophoneArray(np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]), 'pair')
CLIPS = Path(__file__).resolve().parents[4] / 'shared/data/drone_detection/audio'
SQUARE = MicrophoneArray(np.array([[x, y, 0.0] for x in (-0.04, 0.04) for y in (-0.04, 0.04)]), 'square')


def multirotor(seconds, rng):
    """Four rotors of similar, slowly changing speeds (n,): combs with falling harmonics, and blades that hiss."""
    time = np.arange(round(seconds * RATE)) / RATE
    sound = np.zeros(len(time))
    for speed in 190.0 * (1.0 + 0.03 * rng.standard_normal(4)):
        turns = speed * (time + 0.004 * np.sin(2 * np.pi * (0.7 * time + rng.random())))
        sound += sum(0.7**order * np.cos(2 * np.pi * (order * turns + rng.random())) for order in range(1, 25))
    return sound / sound.std() + 0.6 * rng.standard_normal(len(time))


def arriving(array, q, sound, rate=RATE):
    """A periodic sound (n,) of a far source, as the microphones hear it (n, m)."""
    turns = 2j * np.pi * np.fft.rfftfreq(len(sound), 1.0 / rate)[:, None] * (array.positions @ array.basis @ q) / C
    return np.fft.irfft(np.fft.rfft(sound)[:, None] * np.exp(turns), len(sound), axis=0)


def steered(array, samples, q, rate=RATE, others=(), **options):
    spectra = SourceSpectra(array, rate, C)
    spectra.add(samples.astype(np.float32))
    return spectra.steered([np.asarray(q), *others], **options)[0]


@pytest.mark.parametrize(('array', 'here', 'there'), [(PAIR, [0.3], [-0.6]), (SQUARE, [0.3, 0.5], [-0.7, -0.2])])
def test_the_power_of_a_source_is_told_from_that_of_a_louder_one(array, here, there):
    """A source with lines at other frequencies, ten times as strong, adds little to the spectrum of the first."""
    rng = np.random.default_rng(5)
    time = np.arange(2 * RATE) / RATE
    quiet, loud = (sum(np.cos(2 * np.pi * (order * f * time + rng.random())) for order in range(1, 20)) for f in (210.0, 290.0))
    alone = steered(array, arriving(array, here, quiet), here)
    mixed = arriving(array, here, quiet) + 10.0**0.5 * arriving(array, there, loud)
    apart, together = (steered(array, mixed, here, others=others) for others in ([np.array(there)], ()))

    def error(segment):
        return np.abs(segment.power.mean(axis=0) - alone.power.mean(axis=0)).sum() / alone.power.mean(axis=0).sum()

    assert error(apart) < 0.4 * error(together)
    assert apart.total.sum() < 0.5 * together.total.sum()


@pytest.mark.parametrize(('array', 'here', 'there'), [(PAIR, [0.3], [-0.6]), (SQUARE, [0.3, 0.5], [-0.7, -0.2])])
def test_the_power_from_a_direction_is_that_of_its_source(array, here, there):
    """Noise that the microphones do not share, of three times the power, adds nothing on average."""
    rng = np.random.default_rng(1)
    source = 0.1 * rng.standard_normal(2 * RATE)
    alone = steered(array, arriving(array, here, source), here)
    noisy = steered(array, arriving(array, here, source) + 0.17 * rng.standard_normal((2 * RATE, array.channels)), here)
    away = steered(array, arriving(array, there, source), here)
    assert alone.power.sum() == pytest.approx(alone.total.sum(), rel=1e-3)
    assert noisy.power.sum() == pytest.approx(alone.power.sum(), rel=0.1)
    assert noisy.total.sum() > 3.5 * alone.power.sum()
    assert abs(away.power.sum()) < 0.35 * away.total.sum()


def test_lines_of_the_rigs_own_rotors_are_bridged():
    rng = np.random.default_rng(2)
    hiss = 0.01 * rng.standard_normal(2 * RATE)
    hum = hiss + 0.5 * sum(np.sin(2 * np.pi * order * 180.0 * np.arange(2 * RATE) / RATE) for order in range(1, 20))
    clean, loud = (steered(PAIR, np.stack([sound, sound], axis=1), [0.0], blade_pass_hz=np.array([180.0]))
                   for sound in (hiss, hum))
    assert np.median(loud.total) == pytest.approx(np.median(clean.total), rel=0.5)
    assert np.log(loud.total.mean() / clean.total.mean()) < 1.0


def test_features_depend_neither_on_level_nor_on_sample_rate():
    sound = np.stack([multirotor(2.0, np.random.default_rng(3))] * 2, axis=1) * 0.01
    features = DroneFeatures()
    expected = features(steered(PAIR, sound, [0.0]))
    assert len(expected) == DroneFeatures.COUNT
    np.testing.assert_allclose(features(steered(PAIR, 30.0 * sound, [0.0])), expected, atol=0.02)
    faster = features(steered(PAIR, resample_poly(sound, 3, 1), [0.0], rate=3 * RATE))
    different = np.abs(faster - expected) > 0.3  # the resampler attenuates the highest band
    assert different.sum() <= 6


def test_features_of_silence_are_finite():
    empty = np.zeros((12, len(bin_frequencies())))
    assert np.isfinite(DroneFeatures()(Segment(empty, empty))).all()
    assert np.isfinite(DroneFeatures().lines(Segment(empty, empty))).all()


def test_lines_of_one_shaft_move_together():
    """A comb that wanders is sharper where its frames are moved; the lines of four rotors hardly are."""
    rng, time, sharper = np.random.default_rng(11), np.arange(2 * RATE) / RATE, []
    for rotors in (1, 4):
        sound = sum(np.cos(2 * np.pi * order * (190.0 + 3.0 * k) * (time + 0.01 * np.sin(3.0 * time + 1.5 * k)) + 7.0 * order)
                    for order in range(1, 25) for k in range(rotors))
        heard = np.stack([sound, sound], axis=1) + 0.1 * rng.standard_normal((len(time), 2))
        lines = DroneFeatures().lines(steered(PAIR, 0.01 * heard, [0.0]))
        assert lines.shape == (LINES, LINE_CELLS)
        sharper.append(lines[3].std() / lines[2].std() - 1.0)
    assert sharper[0] > 0.02 > 2.0 * sharper[1]


def test_the_model_is_the_mean_of_networks_with_calibration(tmp_path):
    """Against the sums of the layers, written out."""
    rng = np.random.default_rng(4)

    def layer(inputs, outputs):
        return rng.normal(0.0, inputs**-0.5, (inputs, outputs)).astype('f'), rng.normal(0.0, 0.1, outputs).astype('f')

    count = DroneFeatures.COUNT
    networks = [[layer(LINES * 3, 2), layer(2 * len(STEPS), 3), layer(3 * 5, 4), layer(8 + count, 5), layer(5, 1)]
                for _ in range(2)]
    features, lines = rng.standard_normal(count), rng.standard_normal((LINES, LINE_CELLS)).astype('f')

    def output(first, second, third, hidden, last):
        near = np.array([first[1][u] + sum(np.correlate(lines[n], first[0][3 * n:3 * n + 3, u], 'same') for n in range(LINES))
                         for u in range(2)]).clip(0.0)
        orders = np.array([[sum(second[0][2 * n + c, u] * near[c, f + step] for n, step in enumerate(STEPS) for c in range(2)
                                if 0 <= f + step < LINE_CELLS) + second[1][u] for u in range(3)]
                           for f in range(LOWEST_CELL, LOWEST_CELL + FUNDAMENTALS)])
        orders = np.maximum(orders, 0.0)
        beside = np.array([third[1] + sum(orders[f + k, c] * third[0][5 * c + k] for k in range(5) for c in range(3))
                           for f in range(FUNDAMENTALS - 4)])
        beside = np.maximum(beside, 0.0)
        values = np.concatenate([beside.max(axis=0), beside.mean(axis=0), (features - 0.1) / 2.0])
        return (np.maximum(values @ hidden[0] + hidden[1], 0.0) @ last[0] + last[1])[0]

    model = DroneModel(networks, np.full(count, 0.1), np.full(count, 2.0), 0.7, -0.2)
    model.save(tmp_path / 'model.npz')
    expected = 0.7 * np.mean([output(*network) for network in networks]) - 0.2
    assert DroneModel.load(tmp_path / 'model.npz').log_odds(features, lines) == pytest.approx(expected, rel=1e-4)


def test_files_that_are_no_model_are_named(tmp_path):
    (tmp_path / 'text.npz').write_text('no model')
    np.savez(tmp_path / 'other.npz', mean=np.zeros(3), scale=np.ones(3), calibration=np.ones(2))
    with pytest.raises(ValueError, match=r'text\.npz is no model of drone sounds'):
        load_model(str(tmp_path / 'text.npz'))
    with pytest.raises(ValueError, match=r'other\.npz is no model .* 3 features, expected \d+'):
        load_model(str(tmp_path / 'other.npz'))
    with np.load(shipped_file('av_audio', 'models', 'drone_sound.npz')) as file:
        for layer in LAYERS:
            np.savez(tmp_path / 'cut.npz', **{**file, f'{layer}_weights': file[f'{layer}_weights'][:, 1:]})
            with pytest.raises(ValueError, match=r'cut\.npz is no model'):
                load_model(str(tmp_path / 'cut.npz'))
    content = bytearray(shipped_file('av_audio', 'models', 'drone_sound.npz').read_bytes())
    for at in range(300):
        content[at] ^= 255
        (tmp_path / 'damaged.npz').write_bytes(content)
        with contextlib.suppress(OSError, ValueError):  # some bytes, such as dates, do not count
            load_model(str(tmp_path / 'damaged.npz'))
        content[at] ^= 255
    with pytest.raises(OSError, match=r'absent\.npz'):
        load_model(str(tmp_path / 'absent.npz'))
    assert load_model('none') is None


def test_a_drone_is_told_from_a_rumble():
    """More likely a drone than not, and the reverse."""
    rng, q = np.random.default_rng(5), np.array([0.8, 0.2])
    found = {}
    for name, sound in (('drone', multirotor(6.0, rng)), ('rumble', np.cumsum(rng.standard_normal(6 * RATE)) * 0.03)):
        classifier = DroneClassifier(SQUARE, RATE, C, load_model(''))
        classifier.add(0.05 * arriving(SQUARE, q, sound).astype(np.float32))
        (judgement,) = classifier.judge([q])
        found[name] = judgement.probability
    assert found['drone'] > 0.5 > found['rumble']


class Alternating:
    """A model that finds given log-odds, again and again."""

    def __init__(self, *odds) -> None:
        self._odds = cycle(odds)

    def log_odds(self, features: np.ndarray, lines: np.ndarray) -> float:
        return next(self._odds)


def test_what_a_window_says_is_the_likelihood_ratio_of_its_second_alone():
    """In the order of the directions, without anything that was said before of the same or of other directions."""
    classifier = DroneClassifier(SQUARE, RATE, C, Alternating(4.0, -4.0, 0.5))
    classifier.add(0.05 * np.random.default_rng(6).standard_normal((3 * RATE, 4)).astype(np.float32))
    said = classifier.judge([np.array([0.5, 0.2]), np.array([0.6, 0.2])]) + classifier.judge([np.array([0.5, 0.2])])
    np.testing.assert_allclose(np.log([one.probability / (1.0 - one.probability) for one in said]), [4.0, -4.0, 0.5], rtol=1e-6)


@pytest.mark.skipif(not CLIPS.is_dir(), reason=f'{CLIPS} is absent')
def test_recordings_are_told_apart():
    """Clips at 44.1 kHz, from a direction, with noise at 20 dB; the area under the ROC curve by second.

    The model knows these clips. How it judges others is in its card.
    """
    rng, model, features = np.random.default_rng(9), load_model(''), DroneFeatures()
    scores: dict[bool, list[float]] = {True: [], False: []}
    for path in sorted(CLIPS.glob('*.flac')):
        kind, number = path.stem.split('_')
        if (int(number) // 3) % 2:
            continue
        sound, rate = soundfile.read(path, always_2d=True)
        for start in range(0, len(sound) - rate, 2 * rate):
            part = sound[start:start + rate].mean(axis=1)
            heard = arriving(PAIR, np.array([0.4]), part, rate)
            heard += 0.1 * heard.std() * rng.standard_normal(heard.shape)
            segment = steered(PAIR, heard, [0.4], rate)
            scores[kind == 'DRONE'].append(model.log_odds(features(segment), features.lines(segment)))
    drones, others = scores[True], scores[False]
    area = mannwhitneyu(drones, others).statistic / (len(drones) * len(others))
    assert area > 0.9


def test_messages_say_how_likely_a_drone_is():
    rng = np.random.default_rng(6)
    sound = 0.05 * arriving(PAIR, np.array([0.5]), multirotor(4.0, rng))
    messages = feed(DoaStage(PAIR, drone_model=load_model('')), sound.astype(np.float32), rate=RATE)
    judged = [message.hypotheses[0].drone_probability for message in messages]
    assert all(math.isnan(value) for value in judged[:4])   # a second of sound is needed
    assert min(judged[10:]) > 0.6
    for message in messages[10:]:
        assert len({hypothesis.drone_probability for hypothesis in message.hypotheses}) == 1


def test_without_a_model_or_below_its_sample_rate_it_stays_unknown():
    sound = 0.05 * arriving(PAIR, np.array([0.5]), multirotor(2.0, np.random.default_rng(7))).astype(np.float32)
    for stage, rate in ((DoaStage(PAIR), RATE), (DoaStage(PAIR, drone_model=load_model('')), 12_000)):
        judged = [h.drone_probability for message in feed(stage, sound, rate=rate) for h in message.hypotheses]
        assert judged
        assert all(map(math.isnan, judged))


def test_a_gap_makes_it_unknown_again():
    sound = 0.05 * arriving(PAIR, np.array([0.5]), multirotor(4.0, np.random.default_rng(8))).astype(np.float32)
    stage = DoaStage(PAIR, drone_model=load_model(''))
    before = feed(stage, sound[:2 * RATE], rate=RATE)
    after = feed(stage, sound[2 * RATE:], rate=RATE, first_sample=3 * RATE)
    assert not math.isnan(before[-1].hypotheses[0].drone_probability)
    assert math.isnan(after[0].hypotheses[0].drone_probability)
    assert not math.isnan(after[-1].hypotheses[0].drone_probability)
