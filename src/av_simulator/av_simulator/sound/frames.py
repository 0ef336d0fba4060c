"""What the sources send along each ray, filtered by what happens on the way, for one frame of what is received."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal.windows import tukey

from av_simulator.sound.interpolation import BEFORE, TAPS
from av_simulator.sound.stream import Stream

FASTEST = 0.4  # of the speed of sound, at which source and microphones may approach each other
_FRAME_S = 0.02


@dataclass(frozen=True)
class Frame:
    """Signals (sources, rays, length) from emission samples `first` (sources, rays) on; only `active` ones carry sound."""

    signals: NDArray
    first: NDArray
    active: NDArray


class FrameMaker:
    """Filters by finite impulse responses, cross-faded from the previous frame's to this frame's while the frame lasts."""

    def __init__(self, sample_rate: int, signals: Sequence[Stream]):
        self._signals = list(signals)
        self.samples = 2 ** round(np.log2(_FRAME_S * sample_rate))
        self._half = self.samples // 4
        self._taper = tukey(2 * self._half, 0.5, sym=False)
        self.frequency_hz = np.fft.rfftfreq(2 * self._half, 1.0 / sample_rate)
        self._before: tuple[NDArray, NDArray] | None = None

    def make(self, sent: NDArray, factors: NDArray | None, spread: int) -> Frame:
        """The frame at whose beginning what was sent at samples `sent` (sources, rays) is received by the array's centre.

        factors (sources, rays, F) are the responses along the rays at `frequency_hz`; without them nothing is filtered.
        `spread` is how many samples earlier or later than the centre a microphone may receive something.
        """
        first = np.floor(sent).astype(int) - spread - BEFORE - 2
        length = int(self.samples * (1.0 + FASTEST)) + 2 * spread + TAPS + 4
        if factors is None:
            active = np.ones(sent.shape, bool)
            unfiltered = [self._read(number, begins, length) for number, begins in enumerate(first)]
            return Frame(np.array(unfiltered).reshape(*sent.shape, length), first, active)
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
        """The signal of a source from several samples on: (len(begins), length)."""
        low = int(begins.min())
        samples = self._signals[number].read(low, int(begins.max()) + length)
        return samples[(begins - low)[:, None] + np.arange(length)]
