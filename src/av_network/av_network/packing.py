"""Which candidates hold together, when each rig's track can stem from one target only."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp


def best_packing(scores: Sequence[float], members: Sequence[set[Hashable]]) -> NDArray[np.bool_]:
    """The candidates (n,) of the most probable global hypothesis: the largest sum of scores of disjoint candidates.

    This is the multidimensional assignment of track-to-track association (Kaplan, Bar-Shalom and Blair, Assignment costs for
    multiple sensor track-to-track association, IEEE Transactions on Aerospace and Electronic Systems 44(2), 2008), as a 0-1
    linear program.

    Parameters:
        scores (n,): logarithms of odds.
        members: what each candidate consists of.
    """
    worthy = [index for index, score in enumerate(scores) if score > 0.0]
    chosen = np.zeros(len(scores), bool)
    names = sorted({name for index in worthy for name in members[index]}, key=repr)
    if not worthy:
        return chosen
    uses = np.array([[name in members[index] for index in worthy] for name in names], float)
    if np.all(uses.sum(axis=1) <= 1.0):
        chosen[worthy] = True
        return chosen
    found = milp(-np.array(scores)[worthy], integrality=np.ones(len(worthy)), bounds=Bounds(0.0, 1.0),
                 constraints=LinearConstraint(uses, -np.inf, 1.0))
    if found.x is not None:
        chosen[np.array(worthy)[found.x > 0.5]] = True
    return chosen


def log_odds(scores: Sequence[float], members: Sequence[set[Hashable]]) -> NDArray[np.float64]:
    """Logarithms (n,) of the odds of each candidate: the best hypothesis with it over the best one without it.

    -inf for those that are not part of the best hypothesis.

    Parameters:
        scores (n,), members: see `best_packing`.
    """
    best = best_packing(scores, members)
    total, found = float(np.sum(np.array(scores)[best])), np.full(len(scores), -np.inf)
    for index in np.flatnonzero(best):
        rivals = [other for other in range(len(scores)) if other != index]
        if not any(members[other] & members[index] for other in rivals):
            found[index] = scores[index]
            continue
        kept = best_packing([scores[other] for other in rivals], [members[other] for other in rivals])
        found[index] = total - sum(scores[other] for other, is_kept in zip(rivals, kept, strict=True) if is_kept)
    return found
