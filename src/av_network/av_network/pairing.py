"""Candidates from directions of two rigs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from av_common.angles import angles_to_direction
from av_network.hypothesis_filter import LOG_TAU, RIG_SIZE, HypothesisFilter, largest_sigmas
from av_network.lone_track import begin
from av_network.motion_model import velocity_covariance
from av_network.network_target import Member, NetworkTarget
from av_network.observation import Observation
from av_network.settings import NetworkSettings

HOPELESS = -4.0  # score from which a candidate ends
WIDE_M = 300.0  # standard deviation of a position before the first observation
MOST_RELATIVE_SIGMA = 0.5  # of the distance, beyond which a position is not linear enough to begin with
RECENT_S = 0.6  # for which a direction can be paired with that of another rig
MOST_PROPOSED = 8  # candidates by one report
REFUTED_S = 3.0  # for which a pair that was refuted is not proposed again
MOST_PARTNERS = 8  # rigs, those that reported last, with whose directions others are paired: a target needs two
MOST_APART = 9.0  # squared distance of two directions where they are closest, over its variance
LEAST_SINE_SQUARED = 1e-3  # of the angle between two directions


class Lines(NamedTuple):
    """Directions in space.

    Parameters:
        origins (k, 3) (m): of the rigs.
        units (k, 3): along them.
        variances (k,) (rad^2): of the angles.
    """

    origins: NDArray[np.float64]
    units: NDArray[np.float64]
    variances: NDArray[np.float64]


def lines_of(observations: Sequence[Observation], states: HypothesisFilter) -> Lines:
    """Reported directions with the corrections of the rigs' headings.

    Parameters:
        observations (k,): one at least.
        states: what is known of the headings.
    """
    columns = RIG_SIZE * np.array([states.slots[one.rig] for one in observations])
    angles = np.array([one.angles for one in observations])
    units = angles_to_direction(angles[:, 0] + states.rig_mean[columns], angles[:, 1])
    spreads = np.array([one.covariance[0, 0] + one.covariance[1, 1] for one in observations])
    return Lines(np.array([one.position for one in observations]), units,
                 spreads / 2.0 + states.rig_covariance[columns, columns])


def meetings(first: Lines, second: Lines, most_distance: float, slack: float
             ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where each of m directions meets each of k others.

    Returns places (m, k, 3) (m), between both where they are closest, nearer to the more precise one, and squared distances
    (m, k) there over their variance; inf where they do not meet ahead of both rigs and within range.

    Parameters:
        first, second: of different rigs.
        most_distance (m): of a place from either rig.
        slack (m): standard deviation of how far a target moves between the times of the directions.
    """
    a, b, offsets = first.units[:, None], second.units[None], second.origins[None] - first.origins[:, None]
    cosine, along, across = first.units @ second.units.T, np.sum(offsets * a, axis=2), np.sum(offsets * b, axis=2)
    sine = np.maximum(1.0 - cosine**2, LEAST_SINE_SQUARED)
    near, far = (along - cosine * across) / sine, (cosine * along - across) / sine
    spreads = np.minimum(first.variances, 1.0)[:, None] * near**2, np.minimum(second.variances, 1.0) * far**2
    ends = first.origins[:, None] + near[..., None] * a, second.origins + far[..., None] * b
    total = spreads[0] + spreads[1]
    places = (spreads[1][..., None] * ends[0] + spreads[0][..., None] * ends[1]) / np.maximum(total, 1e-12)[..., None]
    apart = np.sum((ends[0] - ends[1]) ** 2, axis=2) / (total + slack**2)
    possible = (1.0 - cosine**2 > LEAST_SINE_SQUARED) & (np.minimum(near, far) > 0.0) & (np.maximum(near, far) < most_distance)
    return places, np.where(possible, apart, np.inf)


def supports(places: NDArray[np.float64], lines: Lines, rigs: Sequence[int], slack: float) -> NDArray[np.intp]:
    """Of how many rigs a direction passes each of n places (n,): where more meet, a meeting is less probably by chance.

    Parameters:
        places (n, 3) (m): the places.
        lines (k,), rigs (k,): directions and the rigs that report them.
        slack (m): see `meetings`.
    """
    offsets = places[:, None] - lines.origins
    along = np.sum(offsets * lines.units, axis=2)
    squared = np.sum(offsets**2, axis=2)
    near = (along > 0.0) & (squared - along**2 < MOST_APART * (np.minimum(lines.variances, 1.0) * squared + slack**2))
    found = np.zeros(len(places), int)
    for rig in set(rigs):
        found += np.any(near[:, np.array(rigs) == rig], axis=1)
    return found


class Pairing:
    """Proposes candidates.

    Parameters:
        settings: see `NetworkSettings`.
    """

    def __init__(self, settings: NetworkSettings) -> None:
        self._settings = settings
        self._contested: dict[tuple[int, int], tuple[Observation, float]] = {}  # newest direction of each track, and its time
        self._refuted: dict[frozenset[tuple[int, int]], float] = {}  # pairs, and until when

    def forget(self, rig: int) -> None:
        """Forget the directions of a rig, by its index."""
        self._contested = {key: pair for key, pair in self._contested.items() if key[0] != rig}

    def refute(self, keys: set[tuple[int, int]], time: float) -> None:
        """Note that tracks are not one target, from a time (s) on; more than two may still hold a pair that is."""
        if len(keys) == 2:
            self._refuted[frozenset(keys)] = time + REFUTED_S

    def propose(self, states: HypothesisFilter, hypotheses: list[NetworkTarget], reported: Sequence[Observation],
                density: float, time: float) -> None:
        """Add candidates from pairs of directions of different rigs that meet, and belong to no hypothesis together.

        Parameters:
            states, hypotheses: to which the candidates are added.
            reported: directions of one rig that may be paired, with all that the rig knows of them.
            density (1/sr): of targets that are not tracked yet.
            time (s): by the reference clock.
        """
        if not reported:
            return
        self._refuted = {pair: until for pair, until in self._refuted.items() if until > time}
        self._contested = {key: pair for key, pair in self._contested.items() if time - pair[1] < RECENT_S}
        owners: dict[tuple[int, int], set[int]] = {}
        for index, each in enumerate(hypotheses):
            for key in each.tracks():
                owners.setdefault(key, set()).add(index)
        latest: dict[int, float] = {}
        for (rig, _), (_, noted) in self._contested.items():
            latest[rig] = max(latest.get(rig, noted), noted)
        near = set(sorted(latest, key=latest.__getitem__)[-MOST_PARTNERS:])
        others = [other for (rig, _), (other, _) in self._contested.items() if rig in near and rig != reported[0].rig]
        room = self._settings.most_candidates - sum(not each.confirmed for each in hypotheses)
        found: list[tuple[float, Observation, Observation, NDArray[np.float64]]] = []
        if others and room > 0:
            lines, slack = lines_of(others, states), self._settings.speed_sigma * RECENT_S
            places, apart = meetings(lines_of(reported, states), lines, self._settings.most_distance, slack)
            found = [(float(apart[m, k]), others[k], reported[m], places[m, k]) for m, k in np.argwhere(apart < MOST_APART)
                     if self._is_open(reported[m].key, others[k].key, owners)]
        if len(found) > min(MOST_PROPOSED, max(room, 0)):
            support = supports(np.array([each[3] for each in found]), lines, [other.rig for other in others], slack)
            found = [found[k] for k in np.lexsort(np.array([[each[0] for each in found], -support]))]
        for one in reported:
            self._contested[one.key] = (one, time)
        if found:
            chosen = found[:min(MOST_PROPOSED, room)]
            places = np.array([place for *_, place in chosen])
            hypotheses += self._begin(states, [pair[1:3] for pair in chosen], places, density, time)

    def _is_open(self, first: tuple[int, int], second: tuple[int, int], owners: dict[tuple[int, int], set[int]]) -> bool:
        """Whether two tracks belong to no hypothesis together, and were not refuted."""
        return owners.get(first, set()).isdisjoint(owners.get(second, ())) and frozenset((first, second)) not in self._refuted

    def _begin(self, states: HypothesisFilter, pairs: Sequence[tuple[Observation, Observation]], places: NDArray[np.float64],
               density: float, time: float) -> list[NetworkTarget]:
        """Candidates of pairs, whose score is the Bayes factor of one target against two; targets are uniform in space."""
        settings, begun = self._settings, states.count
        means = np.concatenate([places, np.zeros((len(pairs), 3))], 1)
        states.add(means, np.array([block_diag(WIDE_M**2 * np.eye(3), velocity_covariance(settings))] * len(pairs)))
        # The prior of the update is Gaussian and wide; at its centre it is replaced by the uniform one.
        prior = math.log(3.0 / settings.most_distance**3) + 1.5 * LOG_TAU + 3.0 * math.log(WIDE_M)
        scores = np.full(len(pairs), prior - math.log(density))
        for part in (0, 1):
            groups: dict[tuple[int, float], list[int]] = {}
            for row, pair in enumerate(pairs):
                groups.setdefault((pair[part].rig, pair[part].time), []).append(row)
            for (rig, _), members in groups.items():
                rows = begun + np.array(members)
                innovations = states.innovations([pairs[row][part] for row in members], rows)
                each = np.arange(len(rows))
                scores[members] += innovations.log_density[each, each]
                states.update(rig, rows, innovations.pick(each, each), np.ones(len(rows), bool))
        new_means, new_covariances = (part[begun:] for part in states.targets())
        nearest = np.min([np.linalg.norm(new_means[:, :3] - [pair[part].position for pair in pairs], axis=1)
                          for part in (0, 1)], axis=0)
        possible = (scores > HOPELESS) & (largest_sigmas(new_covariances)
                                          < np.minimum(MOST_RELATIVE_SIGMA * nearest, 2.0 * settings.most_sigma))
        states.keep([*range(begun), *(begun + np.flatnonzero(possible))])
        return [NetworkTarget(time, time, members={
            one.rig: Member(one.sighting.id, time, 0.5 * float(scores[row]), begin(one, float(nearest[row]), settings))
            for one in pairs[row]}) for row in np.flatnonzero(possible)]
