"""The estimators by name. By default: maximum likelihood where its model holds, even phases where reflections contradict it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from av_audio.band_search import BAND_METHODS, BandSearch
from av_audio.correlation import Correlation, at_centre, maximum_likelihood, phat, plain
from av_audio.ego_noise import NoiseRecording
from av_audio.even_phases import EvenPhases
from av_audio.further_sources import FurtherSources
from av_audio.spectra import CONVERTED_SHARE, HIGHEST_HZ, LEAST_RESPONSE, TINY, SpectrumAnalyzer
from av_audio.steered_response import Peak
from av_common.microphone_array import MicrophoneArray

METHODS = tuple(BAND_METHODS)
# Phases above the band are used up to HIGHEST_HZ, to where converters filter, and to so many wavelengths between the outermost
# microphones.
WIDEBAND_WAVELENGTHS = 10.0  # more make the grid of a plane larger than 170 x 170 points
# Mean square error of q at a wrong peak, and where there is none: that of the sine of an even angle.
WRONG_PEAK = 0.5
# The likelihood is chosen up to the error of the even phases by noise, and this share of theirs by reflections, which shift
# both: fitted to rooms, a head and the free field (`ros2 run av_evaluation hearing robust`).
SHARED_REFLECTIONS = 0.1
# How fast belief changes from one estimate to the other with the ratio of their expected errors. With 1 and 2 errors are the
# same, and 98 to 100 % instead of 89 to 94 % in the free field are within 1.64 sigma (270 windows).
SHARPNESS = 4.0


def make_estimator(method: str, array: MicrophoneArray, sample_rate: int, window: int, band_hz: tuple[float, float],
                   speed_of_sound: float, recording: NoiseRecording | None
                   ) -> tuple[SpectrumAnalyzer, Callable[[NDArray, int], list[Peak]]]:
    """What computes the spectra (m, k) of a window, and what finds the peaks of so many sources in them, the strongest first.

    Parameters:
        method: one of METHODS.
        array: positions of the microphones.
        sample_rate (Hz): sample rate.
        window: number of samples of a window.
        band_hz (Hz): lower and upper edge of the band-pass filter.
        speed_of_sound (m/s): speed of sound.
        recording: of the rig alone, by which spectra are whitened; None whitens nothing. `ml` uses phases above the band, too,
            but whitened those of a line of microphones only: the grid of others would be eight times as large.

    Raises ValueError when the band or the recording do not fit.
    """
    highest = 0.0
    if method == 'ml' and (recording is None or array.rank == 1):
        highest = min(HIGHEST_HZ, CONVERTED_SHARE * sample_rate / 2.0, WIDEBAND_WAVELENGTHS * speed_of_sound / array.aperture)
    analyzer = SpectrumAnalyzer(sample_rate, window, band_hz, highest_hz=highest)
    frequencies, response = analyzer.frequencies, analyzer.response
    if recording is None and method in ('ml', 'phat', 'plain'):
        strongest = (Adaptive(array, frequencies, response, speed_of_sound) if method == 'ml' else
                     Correlation(array, frequencies, response, speed_of_sound, phat if method == 'phat' else plain))
        further = FurtherSources(array, frequencies, speed_of_sound)
        return analyzer, lambda spectra, most: further.beside(spectra, strongest.estimate(spectra), most)
    windows = []
    if recording is not None:
        recording.check(array.channels, sample_rate)
        windows = [analyzer.spectra(part) for part in recording.windows(window)]
    above = frequencies > (np.sqrt(band_hz[0] * band_hz[1]) if highest > band_hz[1] else np.inf)
    return analyzer, BandSearch(array, frequencies, np.where(above, 1.0, response), speed_of_sound, method, windows).peaks


class Adaptive:
    """The estimate with the smaller expected error of two: of the likelihood inside the band, and of even phases in all bins.

    The parameters are those of Correlation; bins outside of the band-pass filter serve the even phases alone.
    """

    def __init__(self, array: MicrophoneArray, frequencies: NDArray, response: NDArray, speed_of_sound: float) -> None:
        inside = np.flatnonzero(response > LEAST_RESPONSE)
        self._inside = slice(inside[0], inside[-1] + 1)
        self._likelihood = Correlation(array, frequencies[self._inside], response[self._inside], speed_of_sound,
                                       maximum_likelihood)
        self._even = EvenPhases(array, frequencies, speed_of_sound)

    def estimate(self, spectra: NDArray) -> Peak:
        """The peak for spectra (m, k)."""
        inside = spectra[:, self._inside]
        likely, drift = self._likelihood.at_rest(inside)
        even, pulled = self._even.estimate(spectra)
        ratio = expected_error(likely) / expected_error(even, SHARED_REFLECTIONS)
        belief = 1.0 / (1.0 + ratio**SHARPNESS)  # that the model of the likelihood holds
        # What pulls the one peak pulls the other; but phases that differ as the source moves look as if reflections did it.
        likely = replace(likely, bias=likely.bias + (1.0 if drift is None else 1.0 - drift.moves) * pulled)
        if drift is not None:
            belief = max(belief, drift.moves)  # the even phases do not know of motion
        chosen = at_centre(_mixture(likely, even, belief), drift) if belief > 0.5 else _mixture(even, likely, 1.0 - belief)
        significance = min(even.significance, likely.significance)
        return replace(chosen, significance=significance, main_share=even.main_share, reflected=even.reflected,
                       curve=even.curve)


def expected_error(peak: Peak, reflected: float = 1.0) -> float:
    """Expected square error of q at a peak, over all its axes, by noise and reflections or because it is a wrong peak.

    Parameters:
        peak: the peak.
        reflected: share of the error by reflections that counts.
    """
    local = max(float(np.trace(peak.covariance + reflected * peak.bias)), TINY)  # that of a channel and its copy is 0
    return peak.main_share * local + (1.0 - peak.main_share) * WRONG_PEAK if peak.main_share > 0.0 else WRONG_PEAK


def _mixture(chosen: Peak, other: Peak, belief: float) -> Peak:
    """The chosen peak, with the expected square error of a mixture of both as its variance.

    Parameters:
        chosen: the peak whose position counts.
        other: the peak of the other estimate.
        belief: probability of the chosen one, 0.5 to 1.
    """
    if not np.all(np.isfinite(other.covariance)):
        return chosen
    apart = chosen.q - other.q
    other_square = other.covariance + other.bias + np.outer(apart, apart)
    return replace(chosen, covariance=belief * chosen.covariance, bias=belief * chosen.bias + (1.0 - belief) * other_square)
