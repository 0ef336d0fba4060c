"""The posterior of many images has the mean of their log-odds."""

import pytest
from scipy.special import expit

from av_vision.score_fusion import ScoreFusion, ScoreFusionModel

PRIOR = -0.9


def judged(values, memory_s, step=0.1):
    fusion = ScoreFusion(ScoreFusionModel(prior=PRIOR, memory_s=memory_s), 1)
    for k, value in enumerate(values):
        fusion.add([expit(value)], step * k)
    return float(fusion.probabilities()[0])


def test_images_make_a_mean_and_no_more():
    assert judged([1.3], 1e6) == pytest.approx(expit(1.3))
    assert judged([1.3] * 40, 1e6) == pytest.approx(expit(1.3))
    assert judged([2.0, -1.0, 0.5, 0.1], 1e6) == pytest.approx(expit(0.4), abs=1e-4)


def test_without_memory_one_image_is_judged_by_itself():
    fusion = ScoreFusion(ScoreFusionModel(), 2)
    for time, seen in enumerate(([0.9, 0.05], [0.2, 0.7])):
        fusion.add(seen, float(time))
        assert fusion.probabilities() == pytest.approx(seen)


def test_what_was_seen_long_ago_is_forgotten():
    fusion = ScoreFusion(ScoreFusionModel(prior=PRIOR, memory_s=3.0), 1)
    for k in range(100):
        fusion.add([0.9], 0.1 * k)
    fusion.add([0.3], 100.0)
    assert fusion.probabilities() == pytest.approx([0.3], abs=1e-6)


def test_metadata_says_how_or_nothing_is_remembered():
    assert ScoreFusionModel.from_metadata({}) == ScoreFusionModel()
    given = ScoreFusionModel.from_metadata({'score_fusion': '{"prior": -1, "correlation": 1, "memory_s": 3, "floor": 0.02}'})
    assert given == ScoreFusionModel(-1, 1, 3, 0.02)
    for text in ('{', '[1]', '{"mood": 1}', '{"correlation": 7}', '{"correlation": 0.6}', '{"prior": "x"}'):
        with pytest.raises(ValueError, match='score_fusion'):
            ScoreFusionModel.from_metadata({'score_fusion': text})
