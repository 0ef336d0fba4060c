"""The model that tells multirotors from other sources by features of a second of sound."""

from __future__ import annotations

from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from av_audio.drone_features import DroneFeatures
from av_common.files import MEGABYTE, check_file

MOST_BYTES = 10 * MEGABYTE
LARGEST_FEATURE = 6.0  # of a standardised feature, in standard deviations
LARGEST_LOG_ODDS = 7.0  # no model is surer than its training data


class DroneModel:
    """A multilayer perceptron with rectified units, whose output is calibrated.

    Parameters:
        layers: weights (n, m) and biases (m,) of each layer; the last has one output.
        mean (n,), scale (n,): of the features in training, by which they are standardised.
        slope, offset: calibration of the output, a logit (Platt, 1999).
    """

    def __init__(self, layers: list[tuple[NDArray, NDArray]], mean: NDArray, scale: NDArray,
                 slope: float = 1.0, offset: float = 0.0) -> None:
        self._layers, self._mean, self._scale, self._slope, self._offset = layers, mean, scale, slope, offset

    def log_odds(self, features: NDArray) -> NDArray:
        """Logarithm of the likelihood ratio (...,) of drones and all else for features (..., n)."""
        values = np.clip((features - self._mean) / self._scale, -LARGEST_FEATURE, LARGEST_FEATURE)
        for number, (weights, biases) in enumerate(self._layers):
            values = (values if number == 0 else np.maximum(values, 0.0)) @ weights + biases
        return np.clip(self._slope * values[..., 0] + self._offset, -LARGEST_LOG_ODDS, LARGEST_LOG_ODDS)

    def calibrated(self, slope: float, offset: float) -> DroneModel:
        """The same model with another calibration."""
        return DroneModel(self._layers, self._mean, self._scale, slope, offset)

    def save(self, path: str | Path) -> None:
        """Write a file that `load` reads."""
        arrays = {'mean': self._mean, 'scale': self._scale, 'calibration': np.array([self._slope, self._offset])}
        for number, (weights, biases) in enumerate(self._layers):
            arrays |= {f'weights_{number}': weights, f'biases_{number}': biases}
        np.savez_compressed(path, allow_pickle=False, **{name: array.astype(np.float32) for name, array in arrays.items()})

    @classmethod
    def load(cls, path: str | Path) -> DroneModel:
        """Read a model. Raises OSError, or ValueError for a file that is none or belongs to other features."""
        try:
            with np.load(check_file(path, MOST_BYTES, 'model'), allow_pickle=False) as file:
                return cls._of({name: file[name] for name in file.files})
        except (KeyError, ValueError, EOFError, TypeError, BadZipFile) as error:
            raise ValueError(f'{path} is no model of drone sounds: {error}') from error

    @classmethod
    def _of(cls, arrays: dict[str, NDArray]) -> DroneModel:
        layers = [(arrays[f'weights_{number}'], arrays[f'biases_{number}'])
                  for number in range(sum(name.startswith('weights_') for name in arrays))]
        features = len(layers[0][0]) if layers else 0
        if features != DroneFeatures.COUNT:
            raise ValueError(f'a model of {features} features, expected {DroneFeatures.COUNT}')
        slope, offset = arrays['calibration'].tolist()
        return cls(layers, arrays['mean'], arrays['scale'], slope, offset)
