"""The odds over the cosine that a linear array measures: all peaks of a window's likelihood."""

from __future__ import annotations

import numpy as np
import pytest
from std_msgs.msg import Header

from av_audio.localizer import Localizer, LocalizerSettings
from av_audio.messages import audio_frame
from av_audio.stage import DoaStage
from av_common.microphone_array import COSINES, DelayCurve, MicrophoneArray
from av_evaluation.hearing.places import PAIR, free_field
from av_evaluation.hearing.signals import RATE, flat

SQUARE = MicrophoneArray(np.array([[0.1, 0.1, 0.0], [0.1, -0.1, 0.0], [-0.1, -0.1, 0.0], [-0.1, 0.1, 0.0]]))


def heard(azimuth_deg, array=PAIR, snr_db=20.0, seed=1):
    """The odds of one window of white noise from a direction."""
    window = free_field([flat], (azimuth_deg, azimuth_deg))(np.random.default_rng(seed), 0.5, snr_db)
    return Localizer(array, RATE, LocalizerSettings()).process(window.sound.astype(np.float32), 0)[0]


@pytest.mark.parametrize('azimuth_deg', [-70.0, -20.0, 0.0, 45.0, 120.0])
def test_the_odds_are_highest_at_the_true_cosine(azimuth_deg):
    """The axis of the pair points to the left: the cosine is the sine of the azimuth."""
    odds = heard(azimuth_deg).odds
    assert abs(COSINES[odds.argmax()] - np.sin(np.radians(azimuth_deg))) < 0.03
    assert odds.min() >= 0.0 and odds.mean() > 1.0


def test_the_mean_odds_are_those_of_a_source():
    """Of noise at both microphones alone they are below one, of a source above."""
    silent = np.random.default_rng(2).normal(size=(RATE // 2, 2)).astype(np.float32) * 0.1
    assert Localizer(PAIR, RATE, LocalizerSettings()).process(silent, 0)[0].odds.mean() < 1.0 < heard(30.0).odds.mean()


def test_two_sources_are_two_peaks():
    """Two noises of equal power at 20 and -40 degrees, of which the hypotheses name one."""
    parts = [free_field([flat], (azimuth, azimuth))(np.random.default_rng(seed), 0.5, 30.0).sound
             for seed, azimuth in ((3, 20.0), (4, -40.0))]
    odds = Localizer(PAIR, RATE, LocalizerSettings()).process(np.sum(parts, axis=0).astype(np.float32), 0)[0].odds
    near = [odds[np.abs(COSINES - np.sin(np.radians(azimuth))) < 0.06].max() for azimuth in (20.0, -40.0)]
    elsewhere = odds[np.abs(COSINES) > 0.85].max()
    assert min(near) > 10.0 * elsewhere


def test_there_are_none_with_a_body_between_the_microphones():
    """One that makes all delays 1.2 times as long. How far its front and back differ lasts, and no window tells."""
    cosines = (-1.0, 0.0, 1.0)
    bent = MicrophoneArray(PAIR.positions / 1.2, 'bent', DelayCurve(cosines, tuple(1.2 * c for c in cosines)))
    found = heard(30.0, bent)
    assert abs(found.cosine - 0.5) < 0.03 and not len(found.odds)


def test_there_are_none_for_planes_for_silence_and_for_other_methods():
    silence = np.zeros((RATE // 2, 2), np.float32)
    assert not len(Localizer(PAIR, RATE, LocalizerSettings()).process(silence, 0)[0].odds)
    noise = np.random.default_rng(5).normal(size=(RATE // 2, 4)).astype(np.float32) * 0.1
    assert not len(Localizer(SQUARE, RATE, LocalizerSettings()).process(noise, 0)[0].odds)
    assert not len(Localizer(PAIR, RATE, LocalizerSettings(method='phat')).process(noise[:, :2], 0)[0].odds)


def test_the_message_has_the_header_of_its_directions():
    window = free_field([flat], (10.0, 10.0))(np.random.default_rng(6), 1.0, 20.0)
    stage = DoaStage(PAIR)
    directions = stage.on_audio(audio_frame(window.sound.astype(np.float32), 0, RATE, Header(frame_id='microphones')), 0.0)
    assert len(directions) == len(stage.odds) > 1
    for message, odds in zip(directions, stage.odds, strict=True):
        assert message.header == odds.header and odds.odds.shape == COSINES.shape
