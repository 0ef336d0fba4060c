"""The fundamental of harmonics: blade-pass frequencies of rotors that are synthesised here."""

from __future__ import annotations

import math

import numpy as np
import pytest

from av_audio import DroneClassifier, load_model
from av_common.microphone_array import MicrophoneArray

RATE = 48_000
PAIR = MicrophoneArray(np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]), 'pair')


def rotors(shaft_hz, blades, imbalance_db, seed, seconds=1.2):
    """Rotors of slightly different speeds: 20 harmonics of the blades, each 1.5 dB weaker, and weak ones of the shaft."""
    random, time = np.random.default_rng(seed), np.arange(round(seconds * RATE)) / RATE
    sound = np.zeros(len(time))
    for speed in shaft_hz * (1.0 + np.array([-0.02, -0.005, 0.01, 0.02])):
        for order in range(1, 20 * blades + 1):
            level = -1.5 * (order // blades) if order % blades == 0 else imbalance_db
            if level == imbalance_db and order > blades:
                continue
            sound += 10.0 ** (level / 20.0) * np.sin(math.tau * (order * speed * time + random.random()))
    return sound


def fundamental_of(sound, noise, seed):
    """What is found broadside of a pair, with noise of standard deviation `noise` that the microphones do not share."""
    classifier = DroneClassifier(PAIR, RATE, 343.0, load_model(''))
    classifier.add((sound[:, None] + noise * np.random.default_rng(seed).normal(size=(len(sound), 2))).astype(np.float32))
    (judgement,) = classifier.judge([np.zeros(1)])
    assert 0.0 <= judgement.probability <= 1.0
    return judgement.fundamental


@pytest.mark.parametrize(('shaft_hz', 'blades'), [(41.0, 2), (66.0, 2), (93.0, 2), (118.0, 2), (153.0, 2), (199.0, 3)])
def test_it_is_the_blade_pass_frequency_and_not_the_shafts(shaft_hz, blades):
    """Also with lines of imbalance between the harmonics, in noise as loud as the rotors."""
    sound = rotors(shaft_hz, blades, -18.0, 1)
    assert fundamental_of(sound, np.std(sound), 2) == pytest.approx(blades * shaft_hz, rel=0.05)


def test_noise_has_none():
    """Nothing stands out of the sound of a source without lines, in noise."""
    found = [fundamental_of(np.random.default_rng(seed).normal(size=round(1.2 * RATE)), 0.5, 10 + seed) for seed in range(5)]
    assert np.isnan(found).all()
