"""Fusion of the class scores of one object in successive images to one posterior probability for each class.

The errors in any two images of one object are the same but for what averages out: the posterior has the mean of the log-odds of
its images, and many images are no surer than that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.config_reader import bounded, parse

LEAST_PROBABILITY = 1e-6  # probabilities are kept this far from 0 and 1


def logit(probability: ArrayLike) -> NDArray[np.float64]:
    """Log-odds of probabilities of any shape, clipped to finite values."""
    clipped = np.clip(np.asarray(probability, float), LEAST_PROBABILITY, 1.0 - LEAST_PROBABILITY)
    return np.asarray(np.log(clipped / (1.0 - clipped)))


@dataclass(frozen=True)
class ScoreFusionModel:
    """Statistics of the scores of one object over images.

    Parameters:
        prior (log-odds): prior of a class among all candidates of a detector.
        correlation: of the log-odds in any two images of one object; only 1 is supported.
        memory_s (s): time in which the weight of an image falls to 1/e; 0 treats images independently.
        floor (0-1): least probability of a candidate box. Images without one say nothing: all things are missed alike.
        threshold (0-1): least posterior of a detection; 0 uses the detector's threshold.
    """

    prior: float = bounded(0.0, low=-20.0, high=20.0)
    correlation: float = bounded(1.0, low=1.0, high=1.0)
    memory_s: float = bounded(0.0, low=0.0)
    floor: float = bounded(0.0, low=0.0, high=1.0)
    threshold: float = bounded(0.0, low=0.0, high=1.0)

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> ScoreFusionModel:
        """From `score_fusion` of a detector's metadata, in JSON; without it images are treated independently.

        Raises ValueError for another entry, or a value outside its bounds.
        """
        model: ScoreFusionModel = parse(cls, metadata.get('score_fusion', '{}'), 'score_fusion')
        return model


SINGLE_IMAGE = ScoreFusionModel()  # images are independent


class ScoreFusion:
    """Recursive posterior of the classes of one object.

    Parameters:
        model: statistics of the scores.
        classes: number of classes.
    """

    def __init__(self, model: ScoreFusionModel, classes: int) -> None:
        self._model = model
        self._sum, self._weight, self._time = np.zeros(classes), 0.0, -np.inf

    def add(self, probabilities: ArrayLike, time: float) -> None:
        """Add an image.

        Parameters:
            probabilities (classes,): probabilities of the classes from this image alone.
            time (s): capture time, not before that of the last image.
        """
        model = self._model
        kept = np.exp((self._time - time) / model.memory_s) if model.memory_s > 0.0 and self._weight else 0.0
        self._sum = kept * self._sum + logit(probabilities)
        self._weight = kept * self._weight + 1.0
        self._time = time

    @property
    def mean(self) -> NDArray[np.float64]:
        """Weighted mean (classes,) of the log-odds of the images."""
        return self._sum / self._weight

    def probabilities(self) -> NDArray[np.float64]:
        """Posterior probabilities (classes,)."""
        return np.asarray(1.0 / (1.0 + np.exp(-self.mean)))
