"""Maximum likelihood where its model of source and noise holds, even phases where reflections contradict it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from av_audio.correlation import Correlation, at_centre
from av_audio.even_phases import EvenPhases
from av_audio.spectra import LEAST_RESPONSE
from av_audio.steered_response import Peak
from av_audio.weighting import maximum_likelihood
from av_common.microphone_array import MicrophoneArray

# Mean square error of q at a wrong peak, and where there is none: that of the sine of an even angle.
WRONG_PEAK = 0.5
# The likelihood is chosen up to the error of the even phases by noise, and this share of theirs by reflections, which shift
# both: fitted to rooms, a head and the free field (`ros2 run av_evaluation hearing robust`).
SHARED_REFLECTIONS = 0.1
# How fast belief changes from one estimate to the other with the ratio of their expected errors. With 1 and 2 errors are the
# same, and 98 to 100 % instead of 89 to 94 % in the free field are within 1.64 sigma (270 windows).
SHARPNESS = 4.0
LEAST_ERROR = 1e-12  # of q, squared: that of a channel and its copy is 0
# Even phases have fewer, wider clusters, so that a source gives a lower significance, by this factor. Without it 32 instead of
# 53 % of windows in rooms have a confidence of 0.9, with as few wrong ones (`ros2 run av_evaluation hearing robust`).
FEWER_CLUSTERS = 1.15


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
        significance = min(FEWER_CLUSTERS * even.significance, likely.significance)
        return replace(chosen, significance=significance, main_share=even.main_share, reflected=even.reflected)


def expected_error(peak: Peak, reflected: float = 1.0) -> float:
    """Expected square error of q at a peak, over all its axes, by noise and reflections or because it is a wrong peak.

    Parameters:
        peak: the peak.
        reflected: share of the error by reflections that counts.
    """
    local = max(float(np.trace(peak.covariance + reflected * peak.bias)), LEAST_ERROR)
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
