"""What is heard in a direction, by all that was heard at its place before: a source keeps its kind, a judgement wavers."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from av_common.track import Source
from av_fusion.filter.doa_likelihood import Comparison
from av_fusion.filter.gaussian_component import ASSOCIATED
from av_fusion.filter.hearing import Hearing
from av_fusion.multi_target.association import association_probabilities, free_factors
from av_fusion.multi_target.bernoulli_track import BernoulliTrack


def kinds_by_place(tracks: Sequence[BernoulliTrack], compared: Sequence[Sequence[Sequence[Comparison]]],
                   heard: Sequence[Hearing], kinds: Sequence[float], fundamentals: NDArray[np.float64], undetected: float
                   ) -> list[float]:
    """Probability (m,) of each direction that it is a target's: that of the track at its place, else that of its sound alone.

    A direction stems from a track of its kind where one explains it. Where none does, it counts for the kind of the track at
    its place, whatever that was taken for: a first judgement may be wrong, and beside a louder source a drone is judged to be
    none for seconds.

    Parameters:
        tracks: the tracks (t,).
        compared: of their components with the directions.
        heard: the directions (m,).
        kinds (m,): probability that each is a target by its sound, NaN while not judged.
        fundamentals (m, k): see `fundamental_likelihoods`.
        undetected: expected number of targets that were not detected yet.
    """
    if not tracks or not heard:
        return list(kinds)
    ratios = np.array([track.sound_ratios(each, heard) * track.blade_pass.fits(fundamentals)
                       for track, each in zip(tracks, compared, strict=True)])
    alike = ratios * np.array([track.kind.fits(kinds) for track in tracks])
    others = 1.0 + undetected * np.array([hearing.confidence / hearing.clutter for hearing in heard])
    explained = association_probabilities(alike, free_factors(alike, others)).max(axis=0) >= ASSOCIATED
    ratios = np.where(explained, alike, ratios * np.array([track.kind.agreement(kinds) for track in tracks]))
    shares = association_probabilities(ratios, free_factors(ratios, others))
    for track, row in zip(tracks, shares, strict=True):
        track.kind.note(Source.SOUND, kinds, row.tolist())
    nearest = shares.argmax(axis=0)
    known = [tracks[t].kind.probability if shares[t, j] >= ASSOCIATED else math.nan for j, t in enumerate(nearest)]
    return [own if math.isnan(one) else one for one, own in zip(known, kinds, strict=True)]
