"""Spectra of an analysis window inside a band-pass filter, and of short blocks of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft  # scipy.signal would double the time in which a node starts

# Bins in which the band-pass filter passes less than this share of the power, 10 dB down, are not used.
LEAST_RESPONSE = 0.1
# Up to this share of half of the sample rate converters pass what they sample.
CONVERTED_SHARE = 0.92
LEAST_BINS, LEAST_HZ = 16, 32.0  # of the band: two groups of bins (`GROUP_HZ` of even_phases.py)
# Of the low-pass prototype: 24 dB per octave beyond either edge.
ORDER = 4
# The sound of drones fades above.
HIGHEST_HZ = 8000.0
# A Tukey window with this tapered share keeps most of the energy (a Hann window has 1.4 times the error) and still
# prevents leakage of strong sounds outside of the band, such as wind.
TAPER = 0.25
# Empty bins of a block above the band, so that its lowest bins do not leak into the highest.
GUARD_BINS = 4
# Within this width phases and levels err alike: what a reflection does to a phase 4 ms later repeats with 250 Hz.
ALIKE_HZ = 250.0
TINY = float(np.finfo(np.float32).tiny)  # instead of 0, where values are divided by


class SpectrumAnalyzer:
    """Tapered spectra of a window inside a Butterworth band-pass filter.

    The filter acts as |H(f)|^2 on the cross-spectra: as if it were applied to both signals, without group delay and
    without a state that would carry sound from one window into the next.

    Parameters:
        sample_rate (Hz): sample rate.
        window_samples: length of the window.
        band_hz (Hz): lower and upper edge of the band, at most half of the sample rate; what converters filter is left out.
        highest_hz (Hz): bins above the band that are kept, up to this frequency.

    Raises ValueError when the band does not fit the sample rate, or is too narrow, or the window is too short for it.
    """

    def __init__(self, sample_rate: int, window_samples: int, band_hz: tuple[float, float], highest_hz: float = 0.0) -> None:
        low, high = band_hz
        converted = CONVERTED_SHARE * sample_rate / 2.0
        if not (0.0 < low < high <= sample_rate / 2.0 and low < converted):
            raise ValueError(f'band_hz={low:g}..{high:g} must rise, begin between 0 and {converted:g} Hz, and end at most at '
                             f'{sample_rate / 2:g} Hz, half of the sample rate')
        high = min(high, converted)
        frequencies = fft.rfftfreq(window_samples, 1.0 / sample_rate)
        response = butterworth_power(frequencies / sample_rate, (low / sample_rate, high / sample_rate), ORDER)
        above = (frequencies > high) & (frequencies <= highest_hz)
        used = np.flatnonzero((response > LEAST_RESPONSE) | above)
        passed = np.count_nonzero(response > LEAST_RESPONSE)
        if passed < LEAST_BINS or passed * frequencies[1] < LEAST_HZ:
            raise ValueError(f'{passed} frequency bins in {low:g}..{high:g} Hz, expected {LEAST_BINS} over {LEAST_HZ:g} Hz: '
                             f'the window of {window_samples / sample_rate:g} s is too short, or the band too narrow')
        self._bins = slice(used[0], used[-1] + 1)
        self._taper = tukey(window_samples, TAPER).astype(np.float32)
        self.frequencies = frequencies[self._bins]
        self.response = response[self._bins]
        self._power_scale = 2.0 / (window_samples * np.sum(self._taper**2))

    def spectra(self, window: NDArray) -> NDArray:
        """Complex spectra (m, k) at `frequencies` (k,) of a window (m, n) of samples, before the band-pass filter."""
        offset = window @ self._taper / self._taper.sum()  # would leak into the band
        return fft.rfft((window - offset[:, None]) * self._taper)[:, self._bins]

    def level_dbfs(self, spectra: NDArray) -> float:
        """Mean power of spectra (m, k) after the filter in dB, 0 dB for a full-scale square wave; -inf for silence."""
        power = self._power_scale * np.sum(self.response * np.abs(spectra) ** 2) / len(spectra)
        return float(10.0 * np.log10(power)) if power > 0.0 else -np.inf


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
        self._samples = hops * self._hop
        self._shape = np.sin(np.pi * (np.arange(2 * self._hop) + 0.5) / (2 * self._hop)).astype(np.float32)
        self.spacing = 0.5 * hops  # of a block's bins in bins of the window
        used = int(len(frequencies) / self.spacing)
        self.frequencies = frequencies[0] + bin_hz * self.spacing * np.arange(used)
        self.times = (np.arange(hops + 1) / hops - 0.5) / bin_hz  # centres of the blocks (b,) in s from that of the window

    def spectra(self, spectra: NDArray) -> NDArray:
        """Spectra (m, b, j) of the blocks at `frequencies` (j,), from spectra (m, k) of the window."""
        signals = fft.ifft(spectra, self._samples)  # complex, moved down by the lowest frequency
        padded = np.zeros((len(signals), self._samples + 2 * self._hop), signals.dtype)
        padded[:, self._hop:-self._hop] = signals
        padded = padded.reshape(len(signals), -1, self._hop)
        blocks = np.concatenate([padded[:, :-1], padded[:, 1:]], axis=-1) * self._shape
        return fft.fft(blocks)[..., :len(self.frequencies)]


def phases_of(spectra: NDArray) -> NDArray:
    """Spectra of any shape with unit magnitude, as of the phase transform (Knapp and Carter, 1976); 0 stays 0."""
    return np.asarray(spectra / np.maximum(np.abs(spectra), TINY))


def butterworth_power(frequencies: NDArray, band: tuple[float, float], order: int) -> NDArray:
    """Power response (k,) of the digital Butterworth band-pass filter that the bilinear transform gives.

    Parameters:
        frequencies (k,): frequencies relative to the sample rate, 0 to 0.5.
        band: edges of the band, relative to the sample rate.
        order: order of the low-pass prototype.

    Source: A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, 3rd ed., 2010, sections 7.2 and 7.3.
    """
    low, high = np.tan(np.pi * np.asarray(band))
    warped = np.tan(np.pi * frequencies[1:])    # 0 passes nothing
    prototype = (warped**2 - low * high) / (warped * (high - low))
    return np.concatenate([[0.0], 1.0 / (1.0 + prototype ** (2 * order))])


def tukey(count: int, share: float) -> NDArray:
    """The symmetric Tukey window (count,), of which a share is tapered by halves of a cosine."""
    from_edge = np.minimum(np.arange(count), np.arange(count)[::-1])
    rise = 2.0 * from_edge / (share * (count - 1))
    return np.where(rise < 1.0, 0.5 - 0.5 * np.cos(np.pi * rise), 1.0)
