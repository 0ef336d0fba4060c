"""The estimators of the suite by name, and what they have in common."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from av_audio.adaptive import Adaptive
from av_audio.band_search import BAND_METHODS, BandSearch
from av_audio.correlation import Correlation
from av_audio.ego_noise import NoiseRecording
from av_audio.further_sources import FurtherSources
from av_audio.spectra import CONVERTED_SHARE, HIGHEST_HZ, SpectrumAnalyzer
from av_audio.steered_response import Peak
from av_audio.weighting import phat, plain
from av_common.microphone_array import MicrophoneArray

METHODS = tuple(BAND_METHODS)
# Phases above the band are used up to HIGHEST_HZ, to where converters filter, and to so many wavelengths between the outermost
# microphones.
WIDEBAND_WAVELENGTHS = 10.0  # more make the grid of a plane larger than 170 x 170 points


class Estimator(Protocol):
    """Finds sources in the spectra of a window."""

    def peaks(self, spectra: NDArray, most: int) -> list[Peak]:
        """Peaks of up to `most` sources for spectra (m, k), the strongest first."""


class PhaseEstimator:
    """One source from weighted phases, and further ones from those that it does not explain.

    Parameters:
        strongest: estimates the strongest.
        further: finds all others.
    """

    def __init__(self, strongest: Adaptive | Correlation, further: FurtherSources) -> None:
        self._strongest, self._further = strongest, further

    def peaks(self, spectra: NDArray, most: int) -> list[Peak]:
        """See Estimator."""
        peak = self._strongest.estimate(spectra)
        return self._further.beside(spectra, peak, most) if most > 1 else [peak]


def make_estimator(method: str, array: MicrophoneArray, sample_rate: int, window: int, band_hz: tuple[float, float],
                   speed_of_sound: float, wideband: bool, recording: NoiseRecording | None
                   ) -> tuple[SpectrumAnalyzer, Estimator]:
    """What computes the spectra of a window, and what finds sources in them.

    Parameters:
        method: one of METHODS.
        array: positions of the microphones.
        sample_rate (Hz): sample rate.
        window: number of samples of a window.
        band_hz (Hz): lower and upper edge of the band-pass filter.
        speed_of_sound (m/s): speed of sound.
        wideband: whether `ml` also uses phases above the band. Whitened, only a line of microphones needs them: the grid of
            others would be eight times as large.
        recording: of the rig alone, by which spectra are whitened; None whitens nothing.

    Raises ValueError when the band or the recording do not fit.
    """
    highest = 0.0
    if method == 'ml' and wideband and (recording is None or array.rank == 1):
        highest = min(HIGHEST_HZ, CONVERTED_SHARE * sample_rate / 2.0, WIDEBAND_WAVELENGTHS * speed_of_sound / array.aperture)
    analyzer = SpectrumAnalyzer(sample_rate, window, band_hz, highest_hz=highest)
    frequencies, response = analyzer.frequencies, analyzer.response
    if recording is None and method in ('ml', 'phat', 'plain'):
        strongest = (Adaptive(array, frequencies, response, speed_of_sound) if method == 'ml' else
                     Correlation(array, frequencies, response, speed_of_sound, phat if method == 'phat' else plain))
        return analyzer, PhaseEstimator(strongest, FurtherSources(array, frequencies, speed_of_sound))
    windows = []
    if recording is not None:
        recording.check(array.channels, sample_rate)
        windows = [analyzer.spectra(part) for part in recording.windows(window)]
    above = frequencies > (np.sqrt(band_hz[0] * band_hz[1]) if highest > band_hz[1] else np.inf)
    return analyzer, BandSearch(array, frequencies, np.where(above, 1.0, response), speed_of_sound, method, windows)
