"""Candidates from directions of two rigs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from av_network.hypothesis_filter import LOG_TAU, RIG_SIZE, HypothesisFilter, largest_sigmas
from av_network.lone_track import begin
from av_network.meeting import MOST_APART, meetings
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
        self._refuted = {pair: until for pair, until in self._refuted.items() if until > time}
        self._contested = {key: pair for key, pair in self._contested.items() if time - pair[1] < RECENT_S}
        headings, variances = states.rig_mean[::RIG_SIZE], np.diag(states.rig_covariance)[::RIG_SIZE]
        owners: dict[tuple[int, int], set[int]] = {}
        for index, each in enumerate(hypotheses):
            for key in each.tracks():
                owners.setdefault(key, set()).add(index)
        found: list[tuple[float, Observation, Observation, NDArray[np.float64]]] = []
        for one in reported:
            others = self._partners(one.key, owners, time)
            if others:
                met = meetings(one, others, headings, variances, self._settings.most_distance,
                               self._settings.speed_sigma * RECENT_S)
                found += [(float(met.apart[k]), other, one, met.places[k]) for k, other in enumerate(others)
                          if met.apart[k] < MOST_APART]
        found.sort(key=lambda each: each[0])
        for one in reported:
            self._contested[one.key] = (one, time)
        if found:
            chosen = found[:MOST_PROPOSED]
            places = np.array([place for *_, place in chosen])
            hypotheses += self._begin(states, [pair[1:3] for pair in chosen], places, density, time)

    def _partners(self, key: tuple[int, int], owners: dict[tuple[int, int], set[int]], time: float) -> list[Observation]:
        """The contested directions of other rigs that a rig's track has not been paired with, nor refuted."""
        own = owners.get(key, set())
        return [other for name, (other, _) in self._contested.items() if name[0] != key[0]
                and own.isdisjoint(owners.get(name, ())) and self._refuted.get(frozenset((key, name)), -math.inf) < time]

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
