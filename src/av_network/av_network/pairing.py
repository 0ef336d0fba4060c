"""Candidates from directions of two rigs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.angles import angles_to_direction
from av_network.apparent_direction import SOUND_SPEED
from av_network.hypothesis_filter import LOG_TAU, HypothesisFilter, largest_sigmas
from av_network.lone_track import begin
from av_network.motion_model import AXES_SHARES, SPEED_SIGMA
from av_network.network_target import Member, NetworkTarget, membership
from av_network.observation import Observation

HOPELESS = -4.0  # score from which a candidate ends
WIDE_M = 300.0  # standard deviation of a position before the first observation
MOST_SIGMA_M = 15.0  # standard deviation of a position, the largest of any axis, at which a track ends
MOST_CANDIDATES = 40  # that are examined at a time
RECENT_S = 0.6  # for which a direction can be paired with that of another rig
MOST_PARTNERS = 8  # rigs, those that reported last, with whose directions others are paired: a target needs two
MOST_APART = 9.0  # squared distance of two directions where they are closest, over its variance
LEAST_SINE_SQUARED = 1e-3  # of the angle between two directions


class Lines(NamedTuple):
    """Directions in space.

    Parameters:
        origins (k, 3) (m): of the rigs.
        units (k, 3): along them.
        variances (k,) (rad^2): of the angles.
        times (k,) (s), time_variances (k,) (s^2): of the capture by the reference clock.
        delays (k,) (s/m): of what is received; 0 for light.
    """

    origins: NDArray[np.float64]
    units: NDArray[np.float64]
    variances: NDArray[np.float64]
    times: NDArray[np.float64]
    time_variances: NDArray[np.float64]
    delays: NDArray[np.float64]


def lines_of(observations: Sequence[Observation]) -> Lines:
    """Reported directions of k observations, one at least."""
    angles = np.array([one.angles for one in observations])
    return Lines(np.array([one.position for one in observations]), angles_to_direction(angles[:, 0], angles[:, 1]),
                 np.array([0.5 * np.trace(one.covariance) for one in observations]),
                 np.array([one.time for one in observations]), np.array([one.known.clock_sigma**2 for one in observations]),
                 np.array([1.0 / SOUND_SPEED if one.sighting.by_sound else 0.0 for one in observations]))


def meetings(first: Lines, second: Lines, most_distance: float
             ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Where each of m directions meets each of k others.

    Returns places (m, k, 3) (m), between both where they are closest, nearer to the more precise one, their times (m, k) (s),
    and squared distances (m, k) there over their variance; inf where they do not meet ahead of both rigs and within range.

    Parameters:
        first, second: of different rigs.
        most_distance (m): of a place from either rig.
    """
    a, b, offsets = first.units[:, None], second.units[None], second.origins[None] - first.origins[:, None]
    cosine, along, across = first.units @ second.units.T, np.sum(offsets * a, axis=2), np.sum(offsets * b, axis=2)
    sine = np.maximum(1.0 - cosine**2, LEAST_SINE_SQUARED)
    near, far = (along - cosine * across) / sine, (cosine * along - across) / sine
    spreads = np.minimum(first.variances, 1.0)[:, None] * near**2, np.minimum(second.variances, 1.0) * far**2
    ends = first.origins[:, None] + near[..., None] * a, second.origins + far[..., None] * b
    total = spreads[0] + spreads[1]
    places = (spreads[1][..., None] * ends[0] + spreads[0][..., None] * ends[1]) / np.maximum(total, 1e-12)[..., None]
    emitted = (first.times - first.delays * near.T).T, second.times - second.delays * far
    moved = SPEED_SIGMA**2 * ((emitted[0] - emitted[1])**2 + first.time_variances[:, None] + second.time_variances)
    apart = np.sum((ends[0] - ends[1]) ** 2, axis=2) / (total + moved)
    possible = (1.0 - cosine**2 > LEAST_SINE_SQUARED) & (np.minimum(near, far) > 0.0) & (np.maximum(near, far) < most_distance)
    return places, 0.5 * (emitted[0] + emitted[1]), np.where(possible, apart, np.inf)


def supports(places: NDArray[np.float64], times: NDArray[np.float64], lines: Lines, rigs: NDArray[np.intp], density: float
             ) -> NDArray[np.float64]:
    """Logarithms (n,) of how much more probable directions are with a target at each of n places than without.

    Of each rig, the direction that fits best counts.

    Parameters:
        places (n, 3) (m), times (n,) (s): of supposed targets.
        lines (k,), rigs (k,): directions and the rigs that report them.
        density (1/sr): of directions without it.
    """
    offsets = places[:, None] - lines.origins
    along = np.sum(offsets * lines.units, axis=2)
    squared = np.sum(offsets**2, axis=2)
    between = times[:, None] - lines.times + lines.delays * np.sqrt(squared)
    spread = np.minimum(lines.variances, 1.0) * squared + SPEED_SIGMA**2 * (between**2 + lines.time_variances)
    gains = np.where(along > 0.0, np.log(squared / (math.tau * density * spread)) - 0.5 * (squared - along**2) / spread, 0.0)
    return np.asarray(sum(np.maximum(gains[:, rigs == rig].max(axis=1), 0.0) for rig in np.unique(rigs)))


class Pairing:
    """Proposes candidates.

    Parameters:
        most_distance (m): of a target from a rig.
    """

    def __init__(self, most_distance: float) -> None:
        self._most_distance = most_distance
        self._contested: dict[int, tuple[float, Sequence[Observation]]] = {}  # newest directions of each rig, and their time

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
        rig, m = reported[0].rig, len(reported)
        recent = sorted((noted, other) for other, (noted, _) in self._contested.items()
                        if other != rig and time - noted < RECENT_S)[-MOST_PARTNERS:]
        others = [one for _, other in recent for one in self._contested[other][1]]
        self._contested[rig] = time, reported
        room = MOST_CANDIDATES - sum(not each.confirmed for each in hypotheses)
        if not others or room <= 0:
            return
        lines = lines_of([*reported, *others])
        places, times, apart = meetings(Lines(*(part[:m] for part in lines)), Lines(*(part[m:] for part in lines)),
                                        self._most_distance)
        together = membership(hypotheses, reported).T @ membership(hypotheses, others)
        rows, columns = np.nonzero((apart < MOST_APART) & ~together)
        if not len(rows):
            return
        rigs = np.array([one.rig for one in (*reported, *others)])
        gains = supports(places[rows, columns], times[rows, columns], lines, rigs, density)
        order = np.argsort(-gains, kind='stable')
        best = np.sort(np.unique(rows[order], return_index=True)[1])  # a direction has one target
        chosen = order[best[:room]]
        hypotheses += self._begin(states, [(others[columns[k]], reported[rows[k]]) for k in chosen],
                                  places[rows, columns][chosen], density, time)

    def _begin(self, states: HypothesisFilter, pairs: Sequence[tuple[Observation, Observation]], places: NDArray[np.float64],
               density: float, time: float) -> list[NetworkTarget]:
        """Candidates of pairs, whose score is the Bayes factor of one target against two; targets are uniform in space."""
        begun = len(states.mean)
        means = np.concatenate([places, np.zeros((len(pairs), 3))], 1)
        states.add(means, np.array([np.diag([*[WIDE_M**2] * 3, *SPEED_SIGMA**2 * AXES_SHARES])] * len(pairs)))
        # The prior of the update is Gaussian and wide; at its centre it is replaced by the uniform one.
        prior = math.log(3.0 / self._most_distance**3) + 1.5 * LOG_TAU + 3.0 * math.log(WIDE_M)
        scores = np.full(len(pairs), prior - math.log(density))
        for part in (0, 1):
            groups: dict[tuple[int, float], list[int]] = {}
            for row, pair in enumerate(pairs):
                groups.setdefault((pair[part].rig, pair[part].time), []).append(row)
            for members in groups.values():
                rows = begun + np.array(members)
                innovations = states.innovations([pairs[row][part] for row in members], rows)
                each = np.arange(len(rows))
                scores[members] += innovations.log_density[each, each]
                states.update(rows, innovations.pick(each, each))
        new_means, new_covariances = (part[begun:] for part in states.targets())
        nearest = np.min([np.linalg.norm(new_means[:, :3] - [pair[part].position for pair in pairs], axis=1)
                          for part in (0, 1)], axis=0)
        possible = (scores > HOPELESS) & (largest_sigmas(new_covariances) < 2.0 * MOST_SIGMA_M)
        states.keep([*range(begun), *(begun + np.flatnonzero(possible))])
        return [NetworkTarget(time, time, members={
            one.rig: Member(one.sighting, time, 0.5 * float(scores[row]), begin(one, float(nearest[row])))
            for one in pairs[row]}) for row in np.flatnonzero(possible)]
