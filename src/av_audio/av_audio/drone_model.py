"""The model that tells multirotors from other sources by features of a second of sound."""

from __future__ import annotations

import math
import zlib
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from av_audio.drone_features import FUNDAMENTALS_HZ, LINE_CELLS, LINES, LOG_STEP, LOWEST_HZ, DroneFeatures
from av_common.files import MEGABYTE, check_file

MOST_BYTES = 10 * MEGABYTE
LARGEST_FEATURE = 6.0  # of a standardised feature, in standard deviations
LARGEST_LOG_ODDS = 7.0  # no model is surer than its training data
# Cells from a fundamental to its 13 orders, which a layer sees together (Bittner et al., ISMIR 2017).
STEPS = tuple(round(math.log(order) / LOG_STEP) for order in range(1, 14))
LOWEST_CELL = round(math.log(FUNDAMENTALS_HZ[0] / LOWEST_HZ) / LOG_STEP)  # of the fundamentals, below those of the lines
FUNDAMENTALS = round(math.log(FUNDAMENTALS_HZ[1] / FUNDAMENTALS_HZ[0]) / LOG_STEP)
LAYERS = ('lines', 'orders', 'fundamentals', 'hidden', 'output')


class DroneModel:
    """Convolutional networks over the lines of a spectrum, whose mean output is calibrated.

    A layer sees neighbouring cells of the logarithmic frequency, the next all orders of a fundamental, the third neighbouring
    fundamentals. The maximum and the mean of all fundamentals, and the features, enter a perceptron. Units are rectified.

    Parameters:
        networks: of each the weights (n, m) and biases (m,) of LAYERS.
        mean (n,), scale (n,): of the features in training, by which they are standardised.
        slope, offset: calibration of the output, a logit (Platt, 1999).
    """

    def __init__(self, networks: list[list[tuple[NDArray, NDArray]]], mean: NDArray, scale: NDArray,
                 slope: float = 1.0, offset: float = 0.0) -> None:
        self._networks, self._mean, self._scale, self._slope, self._offset = networks, mean, scale, slope, offset

    def log_odds(self, features: NDArray, lines: NDArray) -> float:
        """Logarithm of the likelihood ratio of drones and all else for features (n,) and lines (LINES, LINE_CELLS)."""
        values = standardised(features, self._mean, self._scale)
        output = np.mean([_output(network, values, lines.T) for network in self._networks])
        return float(np.clip(self._slope * output + self._offset, -LARGEST_LOG_ODDS, LARGEST_LOG_ODDS))

    def calibrated(self, slope: float, offset: float) -> DroneModel:
        """The same model with another calibration."""
        return DroneModel(self._networks, self._mean, self._scale, slope, offset)

    def save(self, path: str | Path) -> None:
        """Write a file that `load` reads."""
        arrays = {'mean': self._mean, 'scale': self._scale, 'calibration': np.array([self._slope, self._offset])}
        for layer, parts in zip(LAYERS, zip(*self._networks, strict=True), strict=True):
            weights, biases = zip(*parts, strict=True)
            arrays |= {f'{layer}_weights': np.array(weights), f'{layer}_biases': np.array(biases)}
        np.savez_compressed(path, allow_pickle=False, **{name: array.astype(np.float32) for name, array in arrays.items()})

    @classmethod
    def load(cls, path: str | Path) -> DroneModel:
        """Read a model. Raises OSError, or ValueError for a file that is none or belongs to other features."""
        try:
            with np.load(check_file(path, MOST_BYTES, 'model'), allow_pickle=False) as file:
                return cls._of({name: file[name] for name in file.files})
        except (LookupError, ArithmeticError, ValueError, EOFError, TypeError, BadZipFile, zlib.error) as error:
            raise ValueError(f'{path} is no model of drone sounds: {error}') from error

    @classmethod
    def _of(cls, arrays: dict[str, NDArray]) -> DroneModel:
        if len(arrays['mean']) != DroneFeatures.COUNT:
            raise ValueError(f"a model of {len(arrays['mean'])} features, expected {DroneFeatures.COUNT}")
        layers = [list(zip(arrays[f'{layer}_weights'], arrays[f'{layer}_biases'], strict=True)) for layer in LAYERS]
        slope, offset = arrays['calibration'].tolist()
        model = cls([list(network) for network in zip(*layers, strict=True)], arrays['mean'], arrays['scale'], slope, offset)
        model.log_odds(np.zeros(DroneFeatures.COUNT), np.zeros((LINES, LINE_CELLS)))  # layers that fit each other
        return model


def standardised(features: NDArray, mean: NDArray, scale: NDArray) -> NDArray:
    """Features (..., n) in standard deviations."""
    return np.clip((features - mean) / scale, -LARGEST_FEATURE, LARGEST_FEATURE)


def _output(network: list[tuple[NDArray, NDArray]], features: NDArray, lines: NDArray) -> float:
    """Output of a network for standardised features (n,) and lines (LINE_CELLS, LINES)."""
    first, second, third, hidden, output = network
    width = len(first[0]) // lines.shape[1]
    values = _layer(_windows(np.pad(lines, ((width // 2, width // 2), (0, 0))), width), first)
    values = np.pad(values, ((-LOWEST_CELL, STEPS[-1] + FUNDAMENTALS + LOWEST_CELL - LINE_CELLS), (0, 0)))
    values = _layer(np.concatenate([values[step:step + FUNDAMENTALS] for step in STEPS], axis=1), second)
    values = _layer(_windows(values, len(third[0]) // values.shape[1]), third)
    values = _layer(np.concatenate([values.max(axis=0), values.mean(axis=0), features]), hidden)
    return float((values @ output[0] + output[1])[0])


def _windows(values: NDArray, width: int) -> NDArray:
    """Windows (n - width + 1, m * width) of rows (n, m)."""
    return sliding_window_view(values, width, axis=0).reshape(len(values) - width + 1, -1)


def _layer(values: NDArray, layer: tuple[NDArray, NDArray]) -> NDArray:
    """Rectified outputs."""
    return np.asarray(np.maximum(values @ layer[0] + layer[1], 0.0))
