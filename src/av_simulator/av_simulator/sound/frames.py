"""Signals along each ray for one frame of reception, filtered by the frequency response of the ray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal.windows import tukey

from av_simulator.sound.delays import BEFORE, TAPS
from av_simulator.sound.stream import Stream

FASTEST = 0.4  # maximum speed of approach between source and microphones, relative to the speed of sound
_FRAME_S = 0.02  # length of a frame, in which filters are constant


@dataclass(frozen=True)
class Frame:
    """Filtered signals of one frame.

    Parameters:
        signals ((sources, rays, length)): samples at the emission.
        first ((sources, rays)): index of the first emitted sample.
        active ((sources, rays), bool): rays that carry sound.
    """

    signals: NDArray
    first: NDArray
    active: NDArray


class FrameMaker:
    """Filters signals by finite impulse responses, which are cross-faded between consecutive frames.

    Parameters:
        sample_rate (Hz): sample rate.
        signals: emitted signal of each source.
    """

    def __init__(self, sample_rate: int, signals: Sequence[Stream]):
        self._signals = list(signals)
        self.samples = 2 ** round(np.log2(_FRAME_S * sample_rate))
        self._half = self.samples // 4
        self._taper = tukey(2 * self._half, 0.5, sym=False)
        self.frequency_hz = np.fft.rfftfreq(2 * self._half, 1.0 / sample_rate)
        self._before: tuple[NDArray, NDArray] | None = None

    def make(self, sent: NDArray, factors: NDArray, spread: int) -> Frame:
        """The signals of one frame.

        Parameters:
            sent (samples, (sources, rays)): time of emission of the sound that the array's centre receives at the start.
            factors ((sources, rays, F)): responses of the rays at `frequency_hz`.
            spread (samples): maximum difference of the delays between a microphone and the array's centre.
        """
        first = np.floor(sent).astype(int) - spread - BEFORE - 2
        length = int(self.samples * (1.0 + FASTEST)) + 2 * spread + TAPS + 4
        sent_before, factors_before = self._before or (sent - self.samples, factors)
        self._before = sent, factors
        active = np.any(factors, axis=-1) | np.any(factors_before, axis=-1)
        signals = np.zeros((*sent.shape, length))
        size = next_fast_len(length + 2 * self._half, real=True)
        for number, rays in enumerate(active):
            if not rays.any():
                continue
            spectrum = rfft(self._read(number, first[number, rays] - self._half, length + 2 * self._half), size)
            old, new = (irfft(spectrum * self._response(f[number, rays], size), size)[:, 2 * self._half:2 * self._half + length]
                        for f in (factors_before, factors))
            since = first[number, rays, None] + np.arange(length) - sent[number, rays, None]
            share = np.clip(since / (sent - sent_before)[number, rays, None], 0.0, 1.0)
            signals[number, rays] = old + share * (new - old)
        return Frame(signals, first, active)

    def _response(self, factors: NDArray, size: int) -> NDArray:
        """Spectrum of `size` points of the impulse responses, whose middle tap is `_half`, of factors (rays, F)."""
        taps = np.roll(irfft(factors, 2 * self._half), self._half, axis=-1) * self._taper
        return rfft(taps, size)

    def _read(self, number: int, begins: NDArray, length: int) -> NDArray:
        """Parts (len(begins), length) of the signal of a source, which start at several samples."""
        low = int(begins.min())
        samples = self._signals[number].read(low, int(begins.max()) + length)
        return samples[(begins - low)[:, None] + np.arange(length)]
