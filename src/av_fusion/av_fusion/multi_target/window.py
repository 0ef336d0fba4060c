"""The directions of arrival of one window, and which target each stems from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_fusion.filter.doa_likelihood import Comparison
from av_fusion.filter.hearing import Hearing
from av_fusion.measurement.measurements import DoaMeasurement
from av_fusion.multi_target.association import association_probabilities, free_factors, unclaimed
from av_fusion.multi_target.bernoulli_track import BernoulliTrack


class Window(NamedTuple):
    """The directions of arrival of one window.

    Parameters:
        time (s): its capture time.
        heard, kinds (m,): directions in the world, and the probability of each that it is a target, NaN while not judged.
        fundamentals (m, k): see `fundamental_likelihoods`.
        target: numbers of those that are more likely targets than not.
        fraction: effective sample fraction.
        since (s): time since the window before.
    """

    time: float
    heard: Sequence[Hearing]
    kinds: Sequence[float]
    fundamentals: NDArray[np.float64]
    target: Sequence[int]
    fraction: float
    since: float


def kind_of(measurement: DoaMeasurement) -> float:
    """Probability that what is heard is a target; NaN while it is not judged."""
    return math.nan if math.isnan(measurement.drone_probability) else measurement.target_probability


def associate(window: Window, tracks: Sequence[BernoulliTrack], compared: Sequence[Sequence[Sequence[Comparison]]],
              odds: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """How far each direction is free for each track (t, m), its probability to stem from it, and that a new target is heard.

    Parameters:
        window: the directions (m,).
        tracks, compared: the tracks (t,), and their components compared with the directions.
        odds (m,): that a direction stems from a target that was not detected yet, over clutter.
    """
    shape = len(tracks), len(window.heard)
    ratios = np.array([track.sound_ratios(each, window.heard) for track, each in zip(tracks, compared, strict=True)]
                      ).reshape(shape)
    voices = np.array([track.blade_pass.fits(window.fundamentals) * track.kind.fits(window.kinds)
                       for track in tracks]).reshape(shape)
    voices /= np.maximum(voices.max(axis=0, initial=1.0), 1.0)  # an echo sounds alike: only other targets are told apart
    ratios *= voices
    free = free_factors(ratios, 1.0 + odds)
    return free * voices, association_probabilities(ratios, free), unclaimed(ratios, free, 1.0 + odds) * odds / (1.0 + odds)
