"""Which rigs report what the others observe, too."""

from __future__ import annotations

import math
from collections.abc import Mapping

AGREES, BY_CHANCE = 0.5, 0.05  # probability that a track of a rig that is right, at most, or wrong is on others' target
CHANGE_S = 60.0  # mean time for which a rig is right, or wrong
EVIDENCE_S = 1.0  # of a track that counts once: its directions are alike


class RigTrust:
    """The probability that each rig is right, by Bayes' rule: of two hypotheses, between which it changes at a constant rate.

    Half of the tracks of a rig that is right are of targets that others observe, or fewer if that holds for the others'
    tracks, too. One that is wrong, as its heading is far off or its reports are forged, agrees with others only by chance. A
    rig is used while it is more probably right than wrong. This is a sequential test (Wald, Sequential Analysis, 1947) with a
    forgetting that lets rigs in again.
    """

    def __init__(self) -> None:
        self._most = math.log(CHANGE_S / EVIDENCE_S - 1.0)
        self._odds: dict[int, float] = {}  # as far as they are not the most, as at first
        self._noted: dict[int, dict[int, float]] = {}

    def note(self, rig: int, agreeing: Mapping[int, bool], share: float, time: float) -> None:
        """Note a report.

        Parameters:
            rig: index of the rig.
            agreeing: whether each of its tracks, by id, is on a target that other rigs observe.
            share: of the others' tracks that are on targets.
            time (s): by the reference clock.
        """
        before = self._noted.get(rig, {})
        noted = self._noted[rig] = {track: last for track, last in before.items() if 0.0 <= time - last < CHANGE_S}
        usual = min(max(share, BY_CHANCE), AGREES)
        for track, agrees in agreeing.items():
            weight = min((time - noted.get(track, -math.inf)) / EVIDENCE_S, 1.0)
            ratio = math.log(usual / BY_CHANCE if agrees else (1.0 - usual) / (1.0 - BY_CHANCE))
            self._odds[rig] = min(max(self._odds.get(rig, self._most) + weight * ratio, -self._most), self._most)
            noted[track] = time

    def __contains__(self, rig: object) -> bool:
        """Whether a rig, by its index, is more probably right than wrong."""
        return isinstance(rig, int) and self._odds.get(rig, self._most) >= 0.0
