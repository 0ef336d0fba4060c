"""Whether the delays in a recording fit the spacing that an array file states."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from av_common.microphone_array import MicrophoneArray

WINDOW_S = 0.25
LONGEST_S = 3e-3     # delays that are looked for: microphones 1 m apart; rotors repeat themselves after 2.5 ms and more
# A sphere between two microphones makes delays of low frequencies 1.5 times as long (Kuhn, 1977): up to twice, it is a body.
BODY = 2.0
CLEARER = 1.3        # a peak beyond the permitted delays must be so much higher than the highest within them ...
PEAK_SIGMAS = 6.0    # ... and than the correlation of noise: the highest of 300 normal values exceeds 4.5 once in 500 windows
FEWEST = 5           # windows that tell
LARGE_M, ODD_SHARE = 0.5, 0.035    # of microphones that far apart, delays below this share of the permitted ones are odd
BAND_HZ = (200.0, 4000.0)


class SpacingCheck:
    """Counts the windows whose delay between the outermost microphones is longer than their distance permits.

    The delay is that of the phase transform (Knapp and Carter, 1976), looked for up to LONGEST_S.

    Parameters:
        array: the microphones, as the file states.
        sample_rate (Hz): sample rate.
        speed_of_sound (m/s): speed of sound.
    """

    def __init__(self, array: MicrophoneArray, sample_rate: int, speed_of_sound: float) -> None:
        outermost = int(np.argmax(np.linalg.norm(array.baselines, axis=1)))
        self._pair, self._distance = array.pairs[outermost], float(np.linalg.norm(array.baselines[outermost]))
        self._rate, self._speed = sample_rate, speed_of_sound
        self._window = round(WINDOW_S * sample_rate)
        self._waiting = np.zeros((0, 2), np.float32)
        self._within, self._longest = 0, 0.0
        self._beyond: list[float] = []

    def add(self, samples: NDArray) -> None:
        """Take the next samples (n, channels)."""
        self._waiting = np.concatenate([self._waiting, samples[:, self._pair]])
        while len(self._waiting) >= self._window:
            self._judge(self._waiting[:self._window])
            self._waiting = self._waiting[self._window:]

    def problem(self) -> str:
        """What contradicts the file, and the likely mistake; empty where nothing does."""
        if len(self._beyond) < FEWEST or len(self._beyond) <= self._within:
            return ''
        least = self._speed * float(np.median(self._beyond))
        factor = 10.0 ** max(1, round(float(np.log10(least / self._distance))))
        return (f'its delays of {1e3 * least / self._speed:.2f} ms need microphones at least {least:.2g} m apart, by the array '
                f'file they are {self._distance:.3g} m apart; positions are in metres, these may be too small by {factor:g}')

    def doubt(self) -> str:
        """What is odd without contradicting the file: a large array to which all sound comes without delay; empty otherwise."""
        used = self._speed * self._longest
        if self._within < FEWEST or self._distance < LARGE_M or used > ODD_SHARE * self._distance:
            return ''
        return (f'all directions are within {np.degrees(np.arcsin(ODD_SHARE)):.0f} degrees of broadside of microphones '
                f'{self._distance:.3g} m apart: were the positions in centimetres or millimetres? They are read as metres')

    def _judge(self, window: NDArray) -> None:
        spectra = fft.rfft(window * np.hanning(len(window))[:, None], axis=0)
        frequencies = fft.rfftfreq(len(window), 1.0 / self._rate)
        delays, curve, sigma = delay_curve(spectra[:, 0] * spectra[:, 1].conj(), frequencies, len(window), LONGEST_S)
        delays = np.abs(delays)
        permitted = delays <= BODY * self._distance / self._speed + 1.0 / self._rate
        inside, outside = float(curve[permitted].max()), float(curve[~permitted].max(initial=0.0))
        if outside > max(CLEARER * inside, PEAK_SIGMAS * sigma):
            self._beyond.append(float(delays[~permitted][np.argmax(curve[~permitted])]))
        elif inside > PEAK_SIGMAS * sigma:
            self._within += 1
            self._longest = max(self._longest, float(delays[permitted][np.argmax(curve[permitted])]))


def delay_curve(cross: NDArray, frequencies: NDArray, count: int, longest: float) -> tuple[NDArray, NDArray, float]:
    """Generalised cross-correlation with phase transform in BAND_HZ: delays (n,) in s, heights (n,), and their sigma in noise.

    Parameters:
        cross (k,): cross-spectrum.
        frequencies (k,) (Hz): of its bins.
        count: samples of the window.
        longest (s): delays that are looked at.
    """
    used = (frequencies > BAND_HZ[0]) & (frequencies < BAND_HZ[1]) & (np.abs(cross) > 0.0)
    curve = fft.irfft(np.divide(cross, np.abs(cross), out=np.zeros(len(cross), complex), where=used), count)
    rate = count * frequencies[1]
    reach = round(longest * rate)
    sigma = float(np.sqrt(2.0 * np.count_nonzero(used))) / count    # of a sum of as many random phases
    lags = np.arange(-reach, reach + 1)
    return lags / rate, curve[lags], sigma
