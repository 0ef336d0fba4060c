"""Several sources in one window: the sound of rotors with exact delays."""

from itertools import cycle
from types import SimpleNamespace

import numpy as np
import pytest
from known_sound import RATE, add_noise, rotors
from std_msgs.msg import Header

from av_audio import DoaStage, Localizer, LocalizerSettings, audio_frame
from av_common.acoustics import speed_of_sound
from av_common.angles import wrap
from av_common.microphone_array import MicrophoneArray

PAIR = MicrophoneArray([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]])
SQUARE = MicrophoneArray([[x, y, 0.0] for x, y in ((0.04, 0.04), (0.04, -0.04), (-0.04, -0.04), (-0.04, 0.04))])
C = speed_of_sound(20.0)
SECONDS = 0.5


def sources(rng, azimuths, levels_db, array=PAIR, seconds=SECONDS):
    """Sound (n, m) of rotors (s,) at azimuths (rad) and levels (dB), 20 dB above noise in each microphone."""
    total = 0.0
    for azimuth, level in zip(azimuths, levels_db, strict=True):
        wave = rotors(rng, seconds, -array.positions @ [np.cos(azimuth), np.sin(azimuth), 0.0] / C)
        total += 10.0 ** (level / 20.0) * wave / wave.std()
    return add_noise(rng, total, 20.0)


def located(sound, array=PAIR, **settings):
    given = {'max_sources': 4, **settings}
    estimate, = Localizer(array, RATE, LocalizerSettings(window_s=SECONDS, hop_s=SECONDS, **given)).process(sound, 0)
    return estimate


def error(source, azimuth):
    return float(np.min(np.abs(wrap(source.azimuth - azimuth))))


@pytest.mark.parametrize(('array', 'azimuths_deg', 'levels_db', 'found'), [
    (PAIR, (-40.0, 20.0), (0.0, 0.0), 0.95),
    (PAIR, (-40.0, 20.0), (0.0, -5.0), 0.8),
    (PAIR, (-50.0, 0.0, 40.0), (0.0, 0.0, 0.0), 0.7),
    (SQUARE, (-110.0, 20.0), (0.0, -5.0), 0.9),
    (SQUARE, (-110.0, 20.0, 130.0), (0.0, 0.0, 0.0), 0.8)])
def test_each_source_has_a_direction_with_an_honest_sigma(array, azimuths_deg, levels_db, found):
    rng = np.random.default_rng(1)
    within, seen, first = [], 0, []
    for _ in range(20):
        azimuths = np.radians(azimuths_deg) + rng.uniform(-0.05, 0.05, len(azimuths_deg))
        estimate = located(sources(rng, azimuths, levels_db, array), array)
        first.append(error(estimate, azimuths[0]))
        for azimuth in azimuths:
            near = min(estimate.sources, key=lambda source: error(source, azimuth))
            if error(near, azimuth) < np.radians(8.0):
                seen += 1
                within.append(error(near, azimuth) < 1.64 * np.sqrt(near.azimuth_variance[0]))
    assert seen / (20 * len(azimuths_deg)) >= found
    assert np.mean(within) > 0.7
    if levels_db[-1] < 0.0:
        assert np.degrees(np.median(first)) < 1.0  # the louder is the first


def test_a_source_close_to_a_louder_one_is_not_pushed_away():
    """Bins that agree with the louder one are left out; those that remain point away from it."""
    rng = np.random.default_rng(6)
    errors, sigmas = [], []
    for _ in range(40):
        side = rng.choice([-1.0, 1.0])
        places = np.arcsin(rng.uniform(-0.5, 0.5) + side * np.array([0.0, 0.22]))  # 0.22 apart in the measured cosine
        estimate = located(sources(rng, places, (0.0, -5.0)), max_sources=2)
        for found in estimate.further:
            errors.append(side * (np.sin(found.azimuth[0]) - np.sin(places[1])))
            sigmas.append(np.sqrt(found.cosine_variance))
    assert len(errors) > 15
    assert abs(np.median(errors)) < 0.03
    assert np.mean(np.abs(errors) < 1.64 * np.array(sigmas)) > 0.8


def test_one_source_is_one():
    rng = np.random.default_rng(2)
    for _ in range(40):
        azimuth = rng.uniform(-1.2, 1.2)
        estimates = located(sources(rng, [azimuth], [0.0])), located(sources(rng, [azimuth], [0.0]), max_sources=1)
        assert all(error(estimate, azimuth) < np.radians(1.0) for estimate in estimates)
        assert not estimates[1].further
        assert all(further.confidence[0] < 0.9 for further in estimates[0].further)


@pytest.mark.parametrize('azimuth', [-1.4, -0.5, 0.0, 0.2, 1.1])
def test_a_source_without_noise_is_one(azimuth):
    rng = np.random.default_rng(4)
    sound = rotors(rng, SECONDS, -PAIR.positions[:, 1] * np.sin(azimuth) / C)
    assert not located(0.1 * sound / sound.std()).further


def test_the_message_has_a_group_for_each_source():
    odds = cycle(np.log([9.0, 0.25]))  # of a model that finds the first of two more likely a drone
    stage = DoaStage(PAIR, LocalizerSettings(hop_s=SECONDS), drone_model=SimpleNamespace(log_odds=lambda *_: next(odds)))
    sound = sources(np.random.default_rng(3), np.radians([-40.0, 20.0]), [0.0, -3.0], seconds=1.2)
    *_, message = stage.on_audio(audio_frame(sound, 0, RATE, Header()), 0.0)
    assert [(doa.ambiguity_group, round(doa.drone_probability, 1)) for doa in message.hypotheses] == [
        (0, 0.9), (0, 0.9), (1, 0.2), (1, 0.2)]
    cosines = [doa.cosine for doa in message.hypotheses]
    assert cosines[0] == cosines[1] != cosines[2] == cosines[3]
    for doa in message.hypotheses:
        assert doa.cosine == pytest.approx(np.sin(doa.azimuth), abs=1e-6)
