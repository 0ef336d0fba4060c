"""Short overlapping blocks of an analysis window, and their spectra."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

# Empty bins of a block above the band, so that its lowest bins do not leak into the highest.
GUARD_BINS = 4


class Blocks:
    """Cuts a window, given by its spectra inside a band, into overlapping blocks whose powers add up to that of the window.

    Parameters:
        frequencies (k,) (Hz): frequencies of the window's bins.
        hop_s (s): distance of the blocks, half of their length; it is rounded so that a whole number fits into the window.
    """

    def __init__(self, frequencies: NDArray, hop_s: float) -> None:
        bin_hz = float(frequencies[1] - frequencies[0])
        hops = max(1, round(1.0 / (bin_hz * hop_s)))
        self.count = hops + 1
        self._hop = fft.next_fast_len(-(-len(frequencies) // hops) + GUARD_BINS // 2)
        self.samples = hops * self._hop
        self._shape = np.sin(np.pi * (np.arange(2 * self._hop) + 0.5) / (2 * self._hop)).astype(np.float32)
        self.spacing = 0.5 * hops  # of a block's bins in bins of the window
        used = int(len(frequencies) / self.spacing)
        self.frequencies = frequencies[0] + bin_hz * self.spacing * np.arange(used)
        self.times = (np.arange(hops + 1) / hops - 0.5) / bin_hz  # centres of the blocks (b,) in s from that of the window

    def cut(self, signals: NDArray) -> NDArray:
        """Blocks (m, b, n) of signals (m, samples)."""
        padded = np.zeros((len(signals), self.samples + 2 * self._hop), signals.dtype)
        padded[:, self._hop:-self._hop] = signals
        padded = padded.reshape(len(signals), -1, self._hop)
        return np.concatenate([padded[:, :-1], padded[:, 1:]], axis=-1) * self._shape

    def signals(self, spectra: NDArray) -> NDArray:
        """Signals (m, samples), complex, of spectra (m, k) of the window, moved down by its lowest frequency."""
        return fft.ifft(spectra, self.samples)

    def spectra(self, signals: NDArray) -> NDArray:
        """Spectra (m, b, j) of the blocks at `frequencies` (j,) of signals (m, samples)."""
        return fft.fft(self.cut(signals))[..., :len(self.frequencies)]
