"""A cell of a city: reports of the rigs that reach it in, tracks with names that last across borders out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import Header

from av_common.angles import angles_to_direction
from av_common.stamps import to_seconds, to_stamp
from av_interfaces.msg import RigReport, WorldTrack, WorldTrackArray
from av_network.city.grid import Grid
from av_network.messages import PUBLISHED, check_age, check_version, is_place, report_of, target_message
from av_network.network_target import TargetState
from av_network.report_queue import ReportQueue
from av_network.settings import NetworkSettings, RigSettings
from av_network.tracker import NetworkTracker

MARGIN_M = 30.0  # beyond its border to which a cell tracks, so that it has a track before it takes it over
WAIT_S = 0.5  # for late reports
FRESH_S = 2.0  # age of a neighbour's track, or of an own one, whose name counts
MOST_RIGS, MOST_TARGETS = 500, 100  # of one cell
NEIGHBOURS = 8
MOST_SPEED = 200.0  # m/s; the fastest multirotors reach 180 (records of 2025)
NAMES = 2**16  # of a cell: its number times this, and the number of its track
SAME_M = 5.0  # between two cells' estimates of one target at the least, as their rigs differ
SAME_SIGMAS = 4.0


@dataclass
class _Foreign:
    """A neighbour's track: its name, place (3,) (m), velocity (3,) (m/s), and when (s)."""

    name: int
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    time: float


class Cell:
    """Tracks targets in a cell and somewhat beyond; publishes those in it.

    Rigs are known by their reports alone: by satellites they have the time and their place, and they have a surveyed heading.
    A target keeps the name that the cell which it comes from has published.

    Attributes:
        tracker: the tracker.

    Parameters:
        place: (east, north) in the grid.
        grid: the city.
    """

    def __init__(self, place: tuple[int, int], grid: Grid) -> None:
        self.place, self._grid = place, grid
        self.tracker = NetworkTracker((), NetworkSettings(most_distance=grid.reach))
        self._queue = ReportQueue(WAIT_S)
        self._first = (place[1] * grid.cells + place[0]) * NAMES
        self._names: dict[int, int] = {}
        self._told: dict[int, float] = {}  # when own tracks, by id, were published last, within FRESH_S
        self._foreign: dict[int, _Foreign] = {}

    def on_report(self, rig: str, message: RigReport, arrival: float) -> None:
        """Take a rig's report, with its place in the city, on its arrival (s). Raises ValueError for what cannot be used."""
        check_version(rig, message.version)
        check_age(rig, arrival - to_seconds(message.header.stamp))
        position = np.array(message.position, float)
        if not is_place(position):
            raise ValueError(f'{rig} is at {position} m')
        report = report_of(message, rig, position, 0.0)
        near = tuple(one for one in report.sightings if self._grid.passes(
            self.place, position, angles_to_direction(one.azimuth, one.elevation), MARGIN_M))
        if not near:
            return
        if rig not in self.tracker.rigs:
            if len(self.tracker.rigs) >= MOST_RIGS:
                raise ValueError(f'{rig} is one rig more than {MOST_RIGS}')
            self.tracker.join(RigSettings(rig, 0.0, 0.0))
        self._queue.put(report._replace(sightings=near), report.time)

    def on_tracks(self, message: WorldTrackArray, arrival: float) -> None:
        """Take what a neighbour has published, on its arrival (s). Raises ValueError for what no cell publishes."""
        time = to_seconds(message.header.stamp)
        check_age('a neighbour', arrival - time)
        found = {one.id: self._foreign_of(one, time) for one in message.tracks[:MOST_TARGETS]}
        known = {name: each for name, each in self._foreign.items() if arrival - each.time < FRESH_S}
        self._foreign = known | {name: each for name, each in found.items() if name not in known or known[name].time < time}
        if len(message.tracks) > MOST_TARGETS or len(self._foreign) > NEIGHBOURS * MOST_TARGETS:
            self._foreign = known
            raise ValueError(f'more than {MOST_TARGETS} targets of a neighbour')

    def _foreign_of(self, one: WorldTrack, time: float) -> _Foreign:
        position, velocity = (np.array([part.x, part.y, part.z]) for part in (one.position, one.velocity))
        if not (one.positioned and PUBLISHED < one.existence <= 1.0 and 0 < one.id < self._grid.cells**2 * NAMES):
            raise ValueError(f"a neighbour's track {one.id} without a position, a probability or a name")
        if not (is_place(position) and np.linalg.norm(velocity) < MOST_SPEED
                and _is_covariance(one.position_covariance, self.tracker.settings.most_sigma)
                and _is_covariance(one.velocity_covariance, MOST_SPEED)):
            raise ValueError(f"a neighbour's track {one.id} at {position} m, {velocity} m/s, which cannot be")
        return _Foreign(one.id, position, velocity, time)

    def output(self, now: float) -> WorldTrackArray:
        """The targets in the cell at a time (s)."""
        for report in self._queue.ready(now):
            self.tracker.use(report)
        self._foreign = {name: each for name, each in self._foreign.items() if now - each.time < FRESH_S}
        known = self.tracker.states(now) if self.tracker.hypotheses else []
        states = [state for state in known if state.positioned and state.existence > PUBLISHED]
        self._names = {state.target.id: self._names[state.target.id] for state in known if state.target.id in self._names}
        self._told = {own: time for own, time in self._told.items() if now - time < FRESH_S}
        for state in states:
            self._name(state, now)
        tracks = [self._track(state, now) for state in states if self._is_ours(state, now)]
        return WorldTrackArray(header=Header(stamp=to_stamp(now), frame_id='city'), latitude=math.nan, longitude=math.nan,
                               altitude=math.nan, tracks=tracks)

    def _name(self, state: TargetState, now: float) -> None:
        """Give a target the name that a neighbour has published for it, unless it was published under its own since before."""
        own, used = state.target.id, set(self._names.values())
        name = self._names.setdefault(own, self._first + own)
        gate = max(SAME_M, SAME_SIGMAS * math.sqrt(float(np.linalg.eigvalsh(state.covariance[:3, :3])[-1])))
        away = {each.name: float(np.linalg.norm(each.position + (now - each.time) * each.velocity - state.mean[:3]))
                for each in self._foreign.values()}
        nearest = min(away, key=away.__getitem__, default=name)
        settled = own in self._told and name <= nearest
        if nearest != name and away[nearest] < gate and nearest not in used and not settled:
            self._names[own] = nearest

    def _is_ours(self, state: TargetState, now: float) -> bool:
        """Whether a target is in the cell, or has left it and no neighbour tells of it."""
        if self._grid.cell_of(state.mean) == self.place:
            return True
        return state.target.id in self._told and self._names[state.target.id] not in self._foreign

    def _track(self, state: TargetState, now: float) -> WorldTrack:
        self._told[state.target.id] = now
        message = target_message(state, [f'{k}' for k in range(len(self.tracker.rigs))])
        message.id, message.rigs = self._names[state.target.id], []
        return message


def _is_covariance(values: NDArray[np.float64], most: float) -> bool:
    """Whether (9,), row-major, are a covariance, of standard deviations up to `most` along each axis."""
    matrix = np.asarray(values, float).reshape(3, 3)
    return bool(np.all(np.abs(matrix) <= most**2) and np.allclose(matrix, matrix.T, rtol=1e-3)
                and np.linalg.eigvalsh(matrix)[0] >= -1e-6 * np.trace(matrix))


def all_cells(grid: Grid, share: int, shares: int) -> Sequence[tuple[int, int]]:
    """The cells of one of some processes: neighbouring columns together."""
    columns = range(share * grid.cells // shares, (share + 1) * grid.cells // shares)
    return [(x, y) for x in columns for y in range(grid.cells)]
