"""Whether the delays in a recording fit the spacing that an array file states."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from av_audio.spectra import phases_of
from av_common.acoustics import BODY_STRETCH
from av_common.microphone_array import MicrophoneArray

WINDOW_S = 0.25      # in which a walking source 2 m away turns by 10 degrees
LONGEST_S = 3e-3     # delays that are looked for: microphones 1 m apart; rotors repeat themselves after 2.5 ms and more
# One of two sound paths correlates with the other half as much at most as both with themselves: a peak beyond the permitted
# delays must be so much higher than the highest within them ...
CLEARER = 1.3
PEAK_SIGMAS = 6.0    # ... and than the correlation of noise: the highest of 300 normal values exceeds 4.5 once in 500 windows
FEWEST = 5           # windows that tell
# A plane wave crosses microphones in space at the speed of sound, and those in a line or plane faster, the more it comes from
# beside or above. A tenth is that of positions ten times too large.
ODD_SHARE = 0.105
LARGE_M = 0.5        # arrays that may be so: smaller ones are usual
BAND_HZ = (200.0, 4000.0)    # chosen; with 100 to 8000 or 400 to 2000 the tests have the same results


class SpacingCheck:
    """Counts the windows whose delays are longer than the distances of the microphones permit, and how much of these they use.

    Delays are those of the phase transform (Knapp and Carter, 1976), looked for up to LONGEST_S, of as many pairs as the array
    has dimensions: the outermost, and those that are longest across it.

    Parameters:
        array: the microphones, as the file states.
        sample_rate (Hz): sample rate.
        speed_of_sound (m/s): speed of sound.
    """

    def __init__(self, array: MicrophoneArray, sample_rate: int, speed_of_sound: float) -> None:
        across, chosen = array.baselines.copy(), list[int]()
        while len(chosen) < array.rank:
            chosen.append(int(np.argmax(np.linalg.norm(across, axis=1))))
            axis = across[chosen[-1]] / np.linalg.norm(across[chosen[-1]])
            across -= np.outer(across @ axis, axis)
        self._pairs, self._baselines = array.pairs[chosen], array.baselines[chosen]
        self._distances = np.linalg.norm(self._baselines, axis=1)
        self._rate, self._speed = sample_rate, speed_of_sound
        self._window = round(WINDOW_S * sample_rate)
        self._waiting = np.zeros((0, array.channels), np.float32)
        self._within = 0                   # windows with a clear delay that is permitted
        self._shares: list[float] = []     # of those in which all are: speed of sound over that across the array
        self._beyond: list[float] = []     # of others: how much longer than the distance a pair must be at least

    def add(self, samples: NDArray) -> None:
        """Take the next samples (n, channels)."""
        self._waiting = np.concatenate([self._waiting, samples])
        while len(self._waiting) >= self._window:
            window, self._waiting = self._waiting[:self._window], self._waiting[self._window:]
            if np.isfinite(window).all():
                self._judge(window)

    def problem(self) -> str:
        """What contradicts the file, and the likely mistake; empty where nothing does."""
        distance = f'{self._distances[0]:.3g} m'
        if len(self._beyond) >= FEWEST and len(self._beyond) > self._within:
            factor = float(np.median(self._beyond))
            return (f'its delays need microphones at least {factor:.2g} times as far apart as the {distance} of the file; '
                    f'positions are in metres, these may be too small by {decades(factor):g}')
        if len(self._distances) == 3 and self._is_odd() and (share := float(np.median(self._shares))) > 0.0:
            factor = 1.0 / share  # of none: copies of one channel, or microphones closer than a sample
            return (f'sound would cross it at {factor:.2g} times its speed; positions are in metres, these, {distance} apart, '
                    f'are too large by {decades(factor):g}')
        return ''

    def doubt(self) -> str:
        """What is odd without contradicting the file: a large array to which all sound comes without delay; empty otherwise."""
        if len(self._distances) == 3 or self._distances[0] < LARGE_M or not self._is_odd():
            return ''
        where = 'broadside of microphones' if len(self._distances) == 1 else 'straight up from microphones'
        return (f'all directions are within {np.degrees(np.arcsin(ODD_SHARE)):.0f} degrees of {where} {self._distances[0]:.3g} '
                'm apart: are the positions in centimetres or millimetres, or 10 times too large? They are read as metres')

    def _is_odd(self) -> bool:
        """Whether next to no delay is ever used."""
        return len(self._shares) >= FEWEST and float(np.quantile(self._shares, 0.9)) < ODD_SHARE

    def _judge(self, window: NDArray) -> None:
        """Take a window (n, channels) in which each pair has a clear delay."""
        spectra = fft.rfft(window * np.hanning(len(window))[:, None], axis=0)
        frequencies = fft.rfftfreq(len(window), 1.0 / self._rate)
        permitted, beyond = [], []
        for (i, j), distance in zip(self._pairs, self._distances, strict=True):
            delays, curve, sigma = delay_curve(spectra[:, i] * spectra[:, j].conj(), frequencies, len(window), LONGEST_S)
            is_permitted = np.abs(delays) <= BODY_STRETCH * distance / self._speed + 1.0 / self._rate
            inside, outside = float(curve[is_permitted].max()), float(curve[~is_permitted].max(initial=0.0))
            if outside > max(CLEARER * inside, PEAK_SIGMAS * sigma):
                beyond.append(abs(float(delays[~is_permitted][np.argmax(curve[~is_permitted])])) * self._speed / distance)
            elif inside > PEAK_SIGMAS * sigma:
                permitted.append(float(delays[is_permitted][np.argmax(curve[is_permitted])]))
        if beyond:
            self._beyond.append(max(beyond))
            return
        self._within += bool(permitted)
        if len(permitted) == len(self._pairs):
            slowness = np.linalg.pinv(self._baselines) @ (self._speed * np.array(permitted))
            self._shares.append(float(np.linalg.norm(slowness)))


def decades(factor: float) -> float:
    """The power of ten, 10 or more, that is closest to a factor."""
    return 10.0 ** max(1, round(math.log10(factor)))


def delay_curve(cross: NDArray, frequencies: NDArray, count: int, longest: float) -> tuple[NDArray, NDArray, float]:
    """Generalised cross-correlation with phase transform in BAND_HZ: delays (n,) in s, heights (n,), and their sigma in noise.

    Parameters:
        cross (k,): cross-spectrum.
        frequencies (k,) (Hz): of its bins.
        count: samples of the window.
        longest (s): delays that are looked at.
    """
    used = slice(*np.searchsorted(frequencies, BAND_HZ).tolist())
    phases = np.zeros_like(cross)
    phases[used] = phases_of(cross[used])
    curve = fft.irfft(phases, count)
    rate = count * frequencies[1]
    reach = round(longest * rate)
    sigma = math.sqrt(2.0 * np.count_nonzero(phases)) / count    # of a sum of as many random phases
    lags = np.arange(-reach, reach + 1)
    return lags / rate, curve[lags], sigma
