"""Wind at the microphones: turbulence that each capsule hears for itself, the louder the lower the frequency."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from av_common.microphone_array import MicrophoneArray

FRAME_S, FRAMES = 0.08, 25  # two seconds
# Octaves one decade apart. In the lower one sound from anywhere is coherent between close microphones, turbulence is not
# (Corcos, 1964): eddies are shorter than a wavelength by the ratio of wind to sound.
LOW_HZ, HIGH_HZ = (50.0, 100.0), (500.0, 1000.0)
FARTHEST_M = 0.5  # diffuse sound is coherent up to here in the lower octave: sinc(2 d f / c) is 0.87 at 100 Hz
# Fall of the incoherent power between the octaves: noise of circuits falls by 0 to 10 dB a decade (white, flicker), turbulence
# by 23 (f^-7/3 in the inertial range); the middle of both.
TURBULENT_DB = 16.5


class WindMeter:
    """Level of what the two closest microphones do not share, where it falls with frequency as turbulence does.

    Parameters:
        array: positions of the microphones.
        sample_rate (Hz): sample rate.
    """

    def __init__(self, array: MicrophoneArray, sample_rate: int) -> None:
        distances = np.linalg.norm(array.baselines, axis=1)
        closest = int(np.argmin(distances))
        self._pair = list(array.pairs[closest])
        self._usable = bool(distances[closest] <= FARTHEST_M) and sample_rate >= 2.0 * HIGH_HZ[1]
        self._frame = round(FRAME_S * sample_rate)
        frequencies = np.fft.rfftfreq(self._frame, 1.0 / sample_rate)
        self._bands = [(frequencies >= low) & (frequencies < high) for low, high in (LOW_HZ, HIGH_HZ)]
        self._taper = np.hanning(self._frame)[:, None]
        self._samples = np.zeros((0, 2))
        self._spectra: deque[NDArray] = deque(maxlen=FRAMES)

    def add(self, samples: NDArray) -> None:
        """Take the next samples (n, m), full scale 1."""
        if not self._usable:
            return
        self._samples = np.concatenate([self._samples, samples[:, self._pair]])
        while len(self._samples) >= self._frame:
            self._spectra.append(np.fft.rfft(self._samples[:self._frame] * self._taper, axis=0))
            self._samples = self._samples[self._frame:]

    @property
    def level_dbfs(self) -> float:
        """Level of the wind in the lower octave, over FRAMES; -inf without wind, and before so many."""
        if len(self._spectra) < FRAMES:
            return -math.inf
        low, high = (_incoherent(np.array(self._spectra)[:, band]) for band in self._bands)
        widths = [math.log10(hertz[1] - hertz[0]) for hertz in (LOW_HZ, HIGH_HZ)]
        fall = 10.0 * (math.log10(low) - widths[0] - math.log10(high) + widths[1])
        return 10.0 * math.log10(low * 4.0 / float(np.sum(self._taper**2)) / self._frame) if fall > TURBULENT_DB else -math.inf


def _incoherent(spectra: NDArray) -> float:
    """Power that two microphones do not share, from spectra (n, k, 2).

    Of noise, whose phases are random, the mean of n frames keeps 1 / n of the squared cross-power.
    """
    power = np.sqrt(np.prod(np.mean(np.abs(spectra) ** 2, axis=0), axis=1))
    cross = np.abs(np.mean(spectra[..., 0] * spectra[..., 1].conj(), axis=0))
    by_chance = 1.0 / len(spectra)
    coherence = np.clip((cross**2 / np.maximum(power**2, 1e-30) - by_chance) / (1.0 - by_chance), 0.0, 1.0)
    return max(float(np.sum(power * (1.0 - np.sqrt(coherence)))), 1e-30)
