"""What a thing seen again and again is: one probability for each class from all pictures of it.

Model: the log-odds that one picture gives, less the prior's, are normal with the same variance for things that are of the
class and things that are not, and as calibrated as a single picture's probability is (difference of means = variance).
Any two pictures of one thing have the same correlation: what looks like a drone for what it is looks so in every picture,
and only the rest averages out. The mean of n such values is sufficient; its log-likelihood ratio is itself divided by
correlation + (1 - correlation) / n (Gaussian discrimination with equal covariances, Bishop 2006, sec. 4.2.1).
"""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

SUREST = 1e-6  # probabilities are kept this far from 0 and 1


def logit(probability: ArrayLike) -> NDArray[np.float64]:
    """Log-odds."""
    clipped = np.clip(np.asarray(probability, float), SUREST, 1.0 - SUREST)
    return np.log(clipped / (1.0 - clipped))


@dataclass(frozen=True)
class EvidenceModel:
    """How the pictures of one thing belong together.

    prior: log-odds of a class before anything is seen, of all that a detector points to; correlation: of two pictures of one
    thing, 0-1; memory_s: time in which a picture's weight falls to 1/e, 0 to judge each picture by itself; floor: the
    least probability worth following, which stands for a picture in which the thing was not found.
    """

    prior: float = 0.0
    correlation: float = 1.0
    memory_s: float = 0.0
    floor: float = 0.0

    def __post_init__(self) -> None:
        for name, low, high in (('prior', -20.0, 20.0), ('correlation', 0.0, 1.0), ('memory_s', 0.0, 1e6), ('floor', 0.0, 1.0)):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f'{name} is {getattr(self, name)}, expected {low} to {high}')

    @classmethod
    def from_metadata(cls, metadata: dict[str, str]) -> EvidenceModel:
        """The model in the metadata's `evidence` (JSON); without it each picture is judged by itself."""
        text = metadata.get('evidence', '{}')
        try:
            return cls(**json.loads(text))
        except (TypeError, ValueError) as error:
            raise ValueError(f"the metadata's evidence is {text!r}, expected JSON with some of prior, correlation, memory_s "
                             f'and floor: {error}') from error


STILL = EvidenceModel()  # each picture by itself


class Evidence:
    """The evidence about one thing, for each of its possible classes."""

    def __init__(self, model: EvidenceModel, classes: int) -> None:
        self._model = model
        self._sum, self._weight, self._squares = np.zeros(classes), 0.0, 0.0
        self._time = -np.inf

    def add(self, probabilities: ArrayLike, time: float) -> None:
        """Probabilities (classes,) that a picture at a time in s gives."""
        model = self._model
        kept = np.exp((self._time - time) / model.memory_s) if model.memory_s > 0.0 and self._weight else 0.0
        self._sum = kept * self._sum + logit(probabilities)
        self._weight = kept * self._weight + 1.0
        self._squares = kept**2 * self._squares + 1.0
        self._time = time

    def miss(self, time: float) -> None:
        """A picture in which the thing was not found where it should be."""
        self.add(np.full(len(self._sum), self._model.floor), time)

    @property
    def mean(self) -> NDArray[np.float64]:
        """Weighted mean (classes,) of the log-odds of the pictures."""
        return self._sum / self._weight

    @property
    def count(self) -> float:
        """How many equal weights would average as well: (sum of weights)^2 / sum of squares (Kish 1965)."""
        return self._weight**2 / self._squares

    def probabilities(self) -> NDArray[np.float64]:
        """Posterior (classes,)."""
        model = self._model
        spread = model.correlation + (1.0 - model.correlation) / self.count
        return 1.0 / (1.0 + np.exp(-model.prior - (self.mean - model.prior) / spread))
