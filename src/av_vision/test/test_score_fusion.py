"""The posterior of many images against the exact one of correlated Gaussian log-odds."""

import numpy as np
import pytest
from scipy.special import expit
from scipy.stats import multivariate_normal

from av_vision.score_fusion import ScoreFusion, ScoreFusionModel

PRIOR, CORRELATION, VARIANCE = -0.9, 0.6, 2.5
FOREVER = ScoreFusionModel(prior=PRIOR, correlation=CORRELATION, memory_s=1e6, floor=0.02)


def covariance(count):
    return VARIANCE * (CORRELATION + (1.0 - CORRELATION) * np.eye(count))


def things(rng, number, count):
    """Whether each of `number` things is a drone, and the log-odds (number, count) that its images give."""
    drone = rng.random(number) < expit(PRIOR)
    noise = rng.multivariate_normal(np.zeros(count), covariance(count), number)
    return drone, PRIOR + np.where(drone, 0.5, -0.5)[:, None] * VARIANCE + noise


def judged(values, step=0.1):
    fusion = ScoreFusion(FOREVER, 1)
    for k, value in enumerate(values):
        fusion.add([expit(value)], step * k)
    return float(fusion.probabilities()[0])


@pytest.mark.parametrize('count', [1, 2, 7, 40])
def test_it_is_the_exact_bayes_posterior(count):
    _, values = things(np.random.default_rng(count), 20, count)
    for row in values:
        ratio = np.subtract(*(multivariate_normal.logpdf(row, np.full(count, PRIOR + sign * 0.5 * VARIANCE), covariance(count))
                              for sign in (1.0, -1.0)))
        assert judged(row) == pytest.approx(expit(PRIOR + ratio), abs=1e-4)


def test_it_is_as_sure_as_it_is_right():
    drone, values = things(np.random.default_rng(1), 3000, 15)
    posterior = np.array([judged(row) for row in values])
    for low, high in ((0.0, 0.1), (0.1, 0.4), (0.4, 0.7), (0.7, 1.0)):
        some = (posterior >= low) & (posterior < high)
        error = np.sqrt(np.mean(posterior[some] * (1.0 - posterior[some])) / some.sum())
        assert abs(posterior[some].mean() - drone[some].mean()) < 4.0 * error
    assert np.mean((posterior > 0.5) == drone) > np.mean((values[:, 0] > 0.0) == drone)


def test_one_image_is_judged_by_itself():
    assert judged([1.3]) == pytest.approx(expit(1.3))
    fusion = ScoreFusion(ScoreFusionModel(), 2)
    for time, seen in enumerate(([0.9, 0.05], [0.2, 0.7])):
        fusion.add(seen, float(time))
        assert fusion.probabilities() == pytest.approx(seen)


def test_what_was_seen_long_ago_is_forgotten():
    fusion = ScoreFusion(ScoreFusionModel(prior=PRIOR, correlation=CORRELATION, memory_s=3.0), 1)
    for k in range(100):
        fusion.add([0.9], 0.1 * k)
    fusion.add([0.3], 100.0)
    assert fusion.probabilities() == pytest.approx([0.3], abs=1e-6)


def test_metadata_says_how_or_nothing_is_remembered():
    assert ScoreFusionModel.from_metadata({}) == ScoreFusionModel()
    given = ScoreFusionModel.from_metadata({'score_fusion': '{"prior": -1, "correlation": 0.6, "memory_s": 3, "floor": 0.02}'})
    assert given == ScoreFusionModel(-1, 0.6, 3, 0.02)
    for text in ('{', '[1]', '{"mood": 1}', '{"correlation": 7}', '{"prior": "x"}'):
        with pytest.raises(ValueError, match='score_fusion'):
            ScoreFusionModel.from_metadata({'score_fusion': text})
