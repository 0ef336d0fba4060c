"""Which hypotheses hold together, when each rig's track can stem from one target only."""

from __future__ import annotations

from collections.abc import Hashable, Sequence, Set

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse.csgraph import connected_components

Members = Sequence[Set[Hashable]]


def best_packing(scores: Sequence[float], members: Members) -> NDArray[np.bool_]:
    """The hypotheses (n,) of the most probable global one: the largest sum of scores of disjoint hypotheses.

    This is the multidimensional assignment of track-to-track association (Kaplan, Bar-Shalom and Blair, Assignment costs for
    multiple sensor track-to-track association, IEEE Transactions on Aerospace and Electronic Systems 44(2), 2008), as a 0-1
    linear program.

    Parameters:
        scores (n,): logarithms of odds.
        members: what each consists of.
    """
    worthy = [index for index, score in enumerate(scores) if score > 0.0]
    chosen = np.zeros(len(scores), bool)
    if not worthy:
        return chosen
    uses = _uses([members[index] for index in worthy])
    found = milp(-np.array(scores)[worthy], integrality=np.ones(len(worthy)), bounds=Bounds(0.0, 1.0),
                 constraints=LinearConstraint(uses, -np.inf, 1.0))
    if found.x is not None:
        chosen[np.array(worthy)[found.x > 0.5]] = True
    return chosen


def log_odds(scores: Sequence[float], members: Members) -> NDArray[np.float64]:
    """Logarithms (n,) of the odds of each hypothesis: the best global one with it over the best one without it.

    -inf for those that are not part of the best global hypothesis.

    Parameters:
        scores (n,), members: see `best_packing`.
    """
    found = np.full(len(scores), -np.inf)
    for group in _groups(scores, members):
        if len(group) == 1:
            found[group] = np.array(scores)[group]
            continue
        each, sets = [scores[index] for index in group], [members[index] for index in group]
        best = best_packing(each, sets)
        total = float(np.sum(np.array(each)[best]))
        for index in np.flatnonzero(best):
            rivals = [other for other in range(len(group)) if other != index]
            kept = best_packing([each[other] for other in rivals], [sets[other] for other in rivals])
            found[group[index]] = total - sum(each[other] for other, is_kept in zip(rivals, kept, strict=True) if is_kept)
    return found


def _groups(scores: Sequence[float], members: Members) -> list[NDArray[np.intp]]:
    """Hypotheses with positive scores that share members, directly or by others."""
    worthy = np.flatnonzero(np.array(scores) > 0.0)
    uses = _uses([members[index] for index in worthy])
    count, labels = connected_components(uses.T @ uses)
    return [worthy[labels == label] for label in range(count)]


def _uses(members: Members) -> NDArray[np.float64]:
    """Whether (m, n) each of m names is a member of each of n hypotheses."""
    names = sorted(set().union(*members), key=repr)
    return np.array([[name in each for each in members] for name in names], float).reshape(len(names), len(members))
