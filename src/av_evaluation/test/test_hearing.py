"""The laboratory of hearing prints figures with their bounds; sigma in motion, and a head, with its rooms and sounds."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import fftconvolve

from av_audio.localizer import Localizer, LocalizerSettings
from av_evaluation.cli import hearing
from av_evaluation.hearing.free_field import moving, passing_source, pulsing, trials, turning_rig
from av_evaluation.hearing.places import EARS, read_responses
from av_evaluation.hearing.signals import add_noise, recordings, rotors

DATA = Path(__file__).resolve().parents[4] / 'shared/data'
CLIPS, HEAD = DATA / 'drone_detection/audio', DATA / 'kemar/mit_kemar_normal_pinna.sofa'
SECONDS = 0.5


def test_figures_are_printed_with_their_bounds(capsys):
    assert hearing.main(['bound', '--trials', '30']) == 0
    assert capsys.readouterr().out.count('must be <= 1.3: ok') == 3


@pytest.mark.parametrize('arrival', [turning_rig, passing_source])
def test_sigma_is_honest_in_motion(arrival):
    """About 90 % within 1.64 sigma by definition; without a model of motion it was 35 to 60 % for sounds that pulsate."""
    for rate_deg in (0.0, 20.0, 40.0):
        result = trials(np.random.default_rng(5), moving(pulsing(rotors), arrival, np.radians(rate_deg), 10.0), 40)
        assert 75.0 <= result.coverage <= 100.0
        assert np.median(result.error) < 0.4


@pytest.mark.skipif(not HEAD.is_file(), reason=f'{HEAD} is absent')
def test_a_source_beside_a_head_is_one():
    """Between ears phases deviate from those of a delay in some bands, where they fit another direction."""
    rng, (_, responses, rate) = np.random.default_rng(9), read_responses(HEAD)
    recorded, settings = recordings(CLIPS), LocalizerSettings(window_s=SECONDS, hop_s=SECONDS, max_sources=4)
    confidences = []
    for _ in range(40):
        sound = fftconvolve(recorded(rng, SECONDS, np.zeros(1)), responses[rng.integers(len(responses))].T, axes=0)
        sound = sound[:round(SECONDS * rate)]
        estimate, = Localizer(EARS, rate, settings).process(add_noise(rng, sound / sound.std(), 20.0).astype(np.float32), 0)
        confidences.append(sum(further.confidence[0] for further in estimate.further))
    assert np.mean(confidences) < 0.25
