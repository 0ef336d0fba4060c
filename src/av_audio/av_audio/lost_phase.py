"""Sound whose phases a lossy code has removed: it tells levels, and no direction but that of no delay.

Codes of stereo store one signal and two levels for high frequencies, or for all. What noise and reflections do to the ratio of
two channels, X_i / X_j = g (1 + e), is alike in its phase and in the logarithm of its magnitude, as e is circular (for many
small reflections, and for noise). Where the phases deviate from 0 less than the levels from their mean, no air was between
the channels.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from av_audio.spectra import CONVERTED_SHARE, HIGHEST_HZ, TINY

BLOCK_S = 0.02     # frames of codes have 10 to 40 ms
BAND_HZ = 500.0    # 10 bins of a block, as many values for a median
LOWEST_HZ = 500.0    # codes keep the phases below
# Ratio of the medians of both deviations: 1 by the model, and above 0.79 in each of 20 windows of sound from broadside; 0.1 to
# 0.5 where Vorbis and Opus have removed phases (the tests of this module repeat it).
LEAST_RATIO = 0.6
FEWEST_BANDS = 2    # of 15: codes remove whole ranges
FEWEST_BLOCKS = 7    # of a window of 80 ms: medians of fewer have such ratios by chance, in up to 20 % of windows below
ROUNDING = 1e-7    # of the samples, relative: channels that are equal have neither deviation


def has_lost_phases(window: NDArray, sample_rate: float) -> bool:
    """Whether in some bands of a window (m, n) of samples the phases between two neighbouring channels were removed."""
    length = round(BLOCK_S * sample_rate)
    hop = max(1, length // 2)
    blocks = np.lib.stride_tricks.sliding_window_view(window, length, axis=1)[:, ::hop]
    spectra = fft.rfft(blocks * np.hanning(length), axis=2)
    frequencies = fft.rfftfreq(length, 1.0 / sample_rate)
    edges = np.arange(LOWEST_HZ, min(HIGHEST_HZ, CONVERTED_SHARE * sample_rate / 2.0) + 1.0, BAND_HZ)
    starts = np.searchsorted(frequencies, edges)
    ratio = LEAST_RATIO if blocks.shape[1] >= FEWEST_BLOCKS else 0.0
    magnitudes = np.log(np.maximum(np.abs(spectra), TINY))
    for first, second in pairwise(range(len(window))):
        phases = np.abs(np.angle(spectra[first] * spectra[second].conj()))
        levels = magnitudes[first] - magnitudes[second]
        levels -= np.median(levels, axis=1, keepdims=True)    # of an automatic gain
        levels = np.abs(levels - np.median(levels, axis=0))    # of the microphones' responses
        lost = [np.median(phases[:, low:high]) <= ratio * np.median(levels[:, low:high]) + ROUNDING
                for low, high in pairwise(starts)]
        if np.count_nonzero(lost) >= FEWEST_BANDS:
            return True
    return False
