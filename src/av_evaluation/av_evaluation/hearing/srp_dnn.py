"""SRP-DNN for a pair of microphones: a network predicts the phase differences of the direct path, which are then steered.

Source: B. Yang, H. Liu, X. Li, "SRP-DNN: Learning direct-path phase difference for multiple moving sound source localization",
ICASSP 2022. The weights are the authors' (MIT), trained on speech in rooms: `exp/00000002/best_model.tar` of the repository
BingYang-20/SRP-DNN.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import signal
from scipy.special import expit

from av_evaluation.hearing.torch_weights import read_weights

RATE = 16_000  # Hz, of the samples that the network was trained with
FRAME, HOP = 512, 256
POOLS = ((4, 1), (2, 1), (2, 2), (2, 2), (2, 3))  # of frequencies and frames, after each of five blocks
FRAMES = 12  # of one output
MOST_SOURCES = 2.0  # that the outputs are scaled for
SMALLEST = 1e-6
LONGEST_M = 0.12  # distance of two of its twelve microphones, that of the longest pairs
RATE_STEP = 100  # Hz, between rates to which samples are converted
FREQUENCIES = np.arange(1, FRAME // 2 + 1) / FRAME  # relative to the sample rate


class SrpDnn:
    """Causal convolutions, a gated recurrent unit (GRU) and a linear layer; evaluation only.

    Parameters:
        path: weights, saved by PyTorch.

    Raises OSError or ValueError for a file without these weights.
    """

    def __init__(self, path: Path) -> None:
        self._weights = read_weights(path)
        missing = {'cnn.0.conv1.weight', 'cnn.8.bn2.running_var', 'rnn.weight_hh_l0', 'rnn_fc.0.weight'} - set(self._weights)
        if missing:
            raise ValueError(f'{path} is no model of SRP-DNN: it has no {", ".join(sorted(missing))}')

    def cosine(self, sound: NDArray, rate: int, aperture: float, speed_of_sound: float) -> float:
        """Cosine of the angle to the axis of a pair, from -1 to 1; for a pair with a body between, before its delay curve.

        The newest output counts, which knows the whole window; a window too short for one is repeated. A pair longer than those
        of the training is heard at a lower rate, at which it is as short in wavelengths.

        Parameters:
            sound (n, 2): samples; the first channel leads for positive cosines.
            rate (Hz): their rate.
            aperture (m): distance of the microphones.
            speed_of_sound (m/s): speed of sound.
        """
        heard = round(min(1.0, LONGEST_M / aperture) * RATE / RATE_STEP) * RATE_STEP
        common = np.gcd(rate, heard)
        features = pair_features(signal.resample_poly(sound, heard // common, rate // common, axis=0))
        features = np.tile(features, (1, 1, -(-FRAMES // features.shape[-1])))
        real, imaginary = np.split(self.phases(features)[-1], 2)
        cosines = np.linspace(-1.0, 1.0, 721)
        angles = 2.0 * np.pi * np.outer(cosines * aperture / speed_of_sound, FREQUENCIES * heard)
        return float(cosines[np.argmax(np.cos(angles) @ real + np.sin(angles) @ imaginary)])

    def phases(self, features: NDArray) -> NDArray:
        """Cosines and sines (t / FRAMES, 2 k) of the phase differences of the direct path, from features (4, k, t)."""
        values = features
        for number, pool in enumerate(POOLS):
            for layer in (1, 2):
                values = self._convolved(values, f'cnn.{2 * number}.', layer)
            values = _pooled(values, pool)
        return MOST_SOURCES * np.tanh(self._linear(self._recurrent(values.reshape(-1, values.shape[-1]).T), 'rnn_fc.0.'))

    def _convolved(self, values: NDArray, block: str, layer: int) -> NDArray:
        """A causal 3 x 3 convolution of values (c, k, t), normalised and rectified."""
        kernel = self._weights[f'{block}conv{layer}.weight']  # (out, in, frequency, time)
        scale, offset, mean, variance = (self._weights[f'{block}bn{layer}.{name}'][:, None, None]
                                         for name in ('weight', 'bias', 'running_mean', 'running_var'))
        padded = np.pad(values, ((0, 0), (1, 1), (2, 0)))
        patches = sliding_window_view(sliding_window_view(padded, 3, axis=1), 3, axis=2)  # (c, k, t, 3, 3)
        result = np.tensordot(kernel, patches, ((1, 2, 3), (0, 3, 4)))
        return np.maximum((result - mean) / np.sqrt(variance + 1e-5) * scale + offset, 0.0)

    def _recurrent(self, inputs: NDArray) -> NDArray:
        """Outputs (t, h) of the GRU (Cho et al., 2014) for inputs (t, n)."""
        driven = inputs @ self._weights['rnn.weight_ih_l0'].T + self._weights['rnn.bias_ih_l0']
        state, states = np.zeros(driven.shape[1] // 3, np.float32), []
        for row in driven:
            fed_back = self._weights['rnn.weight_hh_l0'] @ state + self._weights['rnn.bias_hh_l0']
            (reset, update, new), (reset_back, update_back, new_back) = np.split(row, 3), np.split(fed_back, 3)
            kept = expit(update + update_back)
            state = (1.0 - kept) * np.tanh(new + expit(reset + reset_back) * new_back) + kept * state
            states.append(state)
        return np.array(states)

    def _linear(self, inputs: NDArray, layer: str) -> NDArray:
        return inputs @ self._weights[f'{layer}weight'].T + self._weights[f'{layer}bias']


def pair_features(sound: NDArray) -> NDArray:
    """Logarithms of the magnitudes and phases (4, FRAME / 2, t) of two channels (n, 2), relative to a running mean level."""
    frames = sliding_window_view(sound, FRAME, axis=0)[::HOP]  # (t, 2, FRAME)
    spectra = np.fft.rfft(frames * signal.get_window('hann', FRAME)).transpose(1, 2, 0)  # (2, k, t)
    level, levels = 0.0, []
    for number, mean in enumerate(np.abs(spectra).mean(axis=(0, 1))):
        kept = (number - 1.0) / (number + 1.0)  # -1 for the first frame, as in the training
        level = kept * level + (1.0 - kept) * mean
        levels.append(level)
    spectra = (spectra / (np.array(levels) + SMALLEST))[:, 1:]
    return np.concatenate([np.log10(np.abs(spectra) + SMALLEST), np.angle(spectra)]).astype(np.float32)


def _pooled(values: NDArray, pool: tuple[int, int]) -> NDArray:
    """Largest of each patch of values (c, k, t); what is left over at the end is dropped."""
    channels, bins, frames = values.shape[0], values.shape[1] // pool[0], values.shape[2] // pool[1]
    whole = values[:, :bins * pool[0], :frames * pool[1]]
    return whole.reshape(channels, bins, pool[0], frames, pool[1]).max(axis=(2, 4))
