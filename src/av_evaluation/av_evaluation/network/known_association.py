"""Filters that are told from which drone each direction stems: how good positions from the same reports can be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import block_diag

from av_evaluation.network.figures import Estimate
from av_network.hypothesis_filter import HypothesisFilter, largest_sigmas
from av_network.meeting import MOST_APART, meetings
from av_network.motion_model import target_motion, velocity_covariance
from av_network.observation import Observation
from av_network.pairing import RECENT_S, WIDE_M
from av_network.report import Report
from av_network.report_queue import ReportQueue
from av_network.reporting import is_precise
from av_network.settings import NetworkSettings, RigSettings
from av_network.tracklets import Tracklets

LOST_M = 40.0  # standard deviation of a position from which a filter begins anew


class KnownAssociation:
    """The filter of `NetworkTracker` with true associations; a `NetworkPeer`.

    A drone's filter begins with the first two directions of different rigs that meet. Positions are reported while they are
    precise, as by the tracker.

    Parameters:
        rigs: the rigs, whose headings are known.
        origins: see `NetworkSimulation`.
        settings: see `NetworkSettings`.
        wait (s): see `ReportQueue`.
    """

    def __init__(self, rigs: Sequence[RigSettings], origins: Mapping[tuple[str, int], int],
                 settings: NetworkSettings | None = None, wait: float = 0.5) -> None:
        self._settings = settings or NetworkSettings()
        self._names = {rig.name: index for index, rig in enumerate(rigs)}
        self._origins, self._queue = origins, ReportQueue(wait)
        self._tracklets = Tracklets(self._settings.rig_manoeuvre, self._settings.rig_rate_sigma)
        self._filter = HypothesisFilter(rigs, self._settings)
        self._drones: list[int] = []  # of the filter's rows
        self._newest: dict[tuple[int, int], Observation] = {}  # by drone and rig
        self._places = {rig.name: np.zeros(3) for rig in rigs}

    def take(self, report: Report, now: float) -> None:
        """See `NetworkPeer`."""
        self._places[report.rig] = report.position
        self._queue.put(report, report.time)

    def estimates(self, now: float) -> list[Estimate]:
        """See `NetworkPeer`."""
        for report in self._queue.ready(now):
            self._use(report)
        means, covariances = self._filter.targets()
        F, Q = target_motion(now - (self._filter.time or now), means[:, 3:6], self._settings)
        found = [Estimate(drone + 1, (F[row] @ means[row])[:6], (F[row] @ covariances[row] @ F[row].T + Q[row])[:6, :6])
                 for row, drone in enumerate(self._drones)]
        places = list(self._places.values())
        return [one for one in found if is_precise(one.mean, one.covariance, places, self._settings)]

    def _use(self, report: Report) -> None:
        rig = self._names[report.rig]
        self._filter.predict(report.time)
        kept = np.flatnonzero(largest_sigmas(self._filter.targets()[1]) < LOST_M).tolist()
        self._filter.keep(kept)
        self._drones = [self._drones[row] for row in kept]
        for tracklet in self._tracklets.fresh(report):
            drone = self._origins.get((report.rig, tracklet.sighting.id))
            if drone is None:
                continue
            one = Observation(rig, report.position, report.time, *tracklet)
            before = self._newest.get((drone, rig))
            self._newest[drone, rig] = one
            if drone in self._drones:
                is_followed = before is not None and before.key == one.key
                self._update(self._drones.index(drone), one if is_followed else one.as_reported())
            else:
                self._begin(drone, one.as_reported())

    def _begin(self, drone: int, one: Observation) -> None:
        """Begin a filter where a direction meets one of another rig."""
        others = [each.as_reported() for (name, rig), each in self._newest.items()
                  if name == drone and rig != one.rig and one.time - each.time < RECENT_S]
        if not others:
            return
        none = np.zeros(len(self._names))
        met = meetings(one, others[:1], none, none, self._settings.most_distance, self._settings.speed_sigma * RECENT_S)
        if met.apart[0] < MOST_APART:
            covariance = block_diag(WIDE_M**2 * np.eye(3), velocity_covariance(self._settings))
            self._filter.add(np.concatenate([met.places, np.zeros((1, 3))], 1), covariance[None])
            self._drones.append(drone)
            for each in (others[0], one):
                self._update(len(self._drones) - 1, each)

    def _update(self, row: int, one: Observation) -> None:
        rows, first = np.array([row]), np.array([0])
        self._filter.update(one.rig, rows, self._filter.innovations([one], rows).pick(first, first), np.array([False]))
