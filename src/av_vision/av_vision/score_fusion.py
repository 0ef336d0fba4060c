"""Fusion of the class scores of one object in successive images to one posterior probability for each class (`tracking`).

The errors in any two images of one object are the same but for what averages out: the posterior has the mean of the log-odds of
its images, and many images are no surer than that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.config_reader import bounded

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


SINGLE_IMAGE = ScoreFusionModel()  # images are independent
