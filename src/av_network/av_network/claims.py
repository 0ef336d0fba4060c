"""Which of the rigs' tracks hypotheses claim."""

from __future__ import annotations

from collections.abc import Sequence

from av_network.network_target import NetworkTarget

WELL_SUPPORTED = 3  # rigs, from which a target's tracks are not thought of otherwise


def explained(hypotheses: Sequence[NetworkTarget], since: float, least_score: float) -> set[tuple[int, int]]:
    """The tracks of probable hypotheses with so many rigs that no others need to be thought of.

    Parameters:
        hypotheses: targets, and candidates that are probable from a score on.
        since (s): time since which a track has been observed.
        least_score: that score.
    """
    members = [(each, each.tracks(since)) for each in hypotheses]
    return {track for each, tracks in members for track in tracks
            if len(tracks) >= WELL_SUPPORTED and (each.confirmed or each.score(tracks) > least_score)}


def claims(hypotheses: Sequence[NetworkTarget], since: float) -> list[set[tuple[int, int]]]:
    """The tracks that each hypothesis claims; a candidate none of those of targets that several other tracks support.

    Parameters:
        hypotheses: targets and candidates.
        since (s): time since which a track has been observed.
    """
    members = [each.tracks(since) for each in hypotheses]
    owned = {track for each, tracks in zip(hypotheses, members, strict=True)
             if each.confirmed and len(tracks) >= WELL_SUPPORTED for track in tracks}
    return [tracks if each.confirmed else tracks - owned for each, tracks in zip(hypotheses, members, strict=True)]
