"""A city: cells of space with a tracker each, which hand tracks over at their borders; simulated rigs and drones.

Cells are key expressions: reports of the rigs that reach one in, tracks with names that last across borders out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import Header

from av_common.angles import angles_to_direction, direction_to_angles
from av_common.stamps import to_seconds, to_stamp
from av_interfaces.msg import RigReport, TargetDirection, WorldTrack, WorldTrackArray
from av_network.messages import PUBLISHED, check_age, check_version, is_place, report_of, target_message
from av_network.network_target import TargetState
from av_network.observation import RigSettings
from av_network.report_queue import ReportQueue
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
REPORTS, TRACKS = 'av/report', 'av/track'  # beginnings of the keys
SIGMA = math.radians(0.5)  # of a direction in a report
HEADING_SIGMA = math.radians(0.2)  # of the surveyed headings
PRESENCE = 0.9  # probability that a report has a drone within reach
RIG_M, DRONE_M = 3.0, 40.0  # heights
LOOK_S = 0.5
HITS_M, SHOWN_S = 10.0, 1.0  # farthest from a drone, and oldest, that a track of it is


@dataclass(frozen=True)
class Grid:
    """Square cells from the origin to the east and to the north.

    Parameters:
        cells: along each side.
        size (m): of a cell.
        reach (m): from a rig to the farthest target that it measures, up to the size: rigs reach their cell and its neighbours.
    """

    cells: int
    size: float
    reach: float

    def cell_of(self, position: NDArray[np.float64]) -> tuple[int, int]:
        """The cell (east, north) of a place; that of one outside is the nearest one."""
        x, y = (min(max(int(value // self.size), 0), self.cells - 1) for value in position[:2])
        return x, y

    def report_key(self, rig: str, position: NDArray[np.float64]) -> str:
        """The key of a rig's reports: the cell in which it stands, and its name."""
        x, y = self.cell_of(position)
        return f'{REPORTS}/{x}/{y}/{rig}'

    def neighbours(self, cell: tuple[int, int]) -> list[tuple[int, int]]:
        """The cells around a cell."""
        columns, rows = (range(max(place - 1, 0), min(place + 2, self.cells)) for place in cell)
        return [(x, y) for x in columns for y in rows if (x, y) != cell]

    def passes(self, cell: tuple[int, int], origin: NDArray[np.float64], unit: NDArray[np.float64], margin: float) -> bool:
        """Whether a direction within its reach comes as near to a cell as a margin (m), seen from above."""
        points = origin[:2] + np.linspace(0.0, self.reach, 9)[:, None] * unit[:2]
        low = self.size * np.array(cell) - margin
        return bool(np.any(np.all((points > low) & (points < low + self.size + 2.0 * margin), axis=1)))


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
        self.tracker = NetworkTracker((), grid.reach)
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
        if not (one.positioned and 0 < one.id < self._grid.cells**2 * NAMES and is_place(position)
                and np.linalg.norm(velocity) < MOST_SPEED):
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


def all_cells(grid: Grid, share: int, shares: int) -> Sequence[tuple[int, int]]:
    """The cells of one of some processes: neighbouring columns together."""
    columns = range(share * grid.cells // shares, (share + 1) * grid.cells // shares)
    return [(x, y) for x in columns for y in range(grid.cells)]


class World:
    """Rigs on a jittered lattice, and drones that fly to and fro across them at 8 to 20 m/s.

    Attributes:
        places (r, 3) (m): of the rigs.

    Parameters:
        grid: the city.
        rigs, drones: their numbers.
        seed: of all draws.
    """

    def __init__(self, grid: Grid, rigs: int, drones: int, seed: int) -> None:
        random = np.random.default_rng(seed)
        side, extent = math.ceil(math.sqrt(rigs)), grid.cells * grid.size
        lattice = np.array([(k % side, k // side) for k in range(rigs)]) + random.uniform(0.2, 0.8, (rigs, 2))
        self.places = np.concatenate([lattice * extent / side, np.full((rigs, 1), RIG_M)], 1)
        self._headings = random.normal(0.0, HEADING_SIGMA, rigs)
        self._random, self._reach, self._extent = random, grid.reach, extent
        self._begin = random.uniform(0.0, math.tau, (drones, 2))
        self._rate = random.uniform(8.0, 14.0, (drones, 2)) / (0.4 * extent)
        self._phase = random.uniform(0.0, math.tau, drones)
        self._looked, self._is_near = -math.inf, np.ones(rigs, bool)

    def drones(self, time: float) -> NDArray[np.float64]:
        """Positions (n, 3) (m) of the drones, which weave, at a time (s) since the beginning."""
        weave = 4.0 * np.stack([np.sin(0.6 * time + self._phase), np.cos(0.5 * time + self._phase)], 1)
        level = self._extent * (0.5 + 0.4 * np.sin(self._begin + self._rate * time)) + weave
        return np.concatenate([level, DRONE_M + 5.0 * np.sin(0.2 * time + self._phase)[:, None]], 1)

    def is_near(self, rig: int, time: float) -> bool:
        """Whether a rig may measure a drone, by what was looked up within the last LOOK_S."""
        if time - self._looked > LOOK_S:
            away = np.linalg.norm(self.places[:, None] - self.drones(time), axis=2)
            self._looked, self._is_near = time, np.min(away, axis=1) < self._reach + 20.0 * LOOK_S
        return bool(self._is_near[rig])

    def report(self, rig: int, time: float, begin: float) -> RigReport:
        """What a rig measures at a time (s) since the beginning (s since 1970)."""
        offsets = self.drones(time) - self.places[rig]
        near = np.flatnonzero((np.linalg.norm(offsets, axis=1) < self._reach)
                              & (self._random.random(len(offsets)) < PRESENCE))
        stamp = to_stamp(begin + time)
        message = RigReport(version=RigReport.VERSION, position=self.places[rig].astype(np.float32))
        message.header.stamp = stamp
        for drone in near:
            azimuth, elevation = map(float, direction_to_angles(offsets[drone]))
            across, up = SIGMA * self._random.normal(size=2)
            message.directions.append(TargetDirection(
                id=int(drone) + 1, azimuth=azimuth + across / math.cos(elevation) - self._headings[rig],
                elevation=elevation + up, information=np.array([1.0, 0.0, 1.0], np.float32) / SIGMA**2, measured=stamp,
                existence=0.99, drone_probability=0.9, seen=True, resolved=True))
        return message


class Names:
    """Which names the drones have in what all cells publish.

    Attributes:
        looks, found, twice: numbers of looks at a drone, of those with a track of it, and of those with two names.
        changes: number of times at which a drone's name changed.
        borders: number of borders that drones crossed.

    Parameters:
        grid: the city.
        drones: their number.
    """

    def __init__(self, grid: Grid, drones: int) -> None:
        self._grid = grid
        self._names, self._cells = [0] * drones, [(-1, -1)] * drones
        self._tracks: dict[int, tuple[float, NDArray[np.float64], NDArray[np.float64]]] = {}
        self.looks = self.found = self.twice = self.changes = self.borders = 0

    def take(self, name: int, time: float, position: NDArray[np.float64], velocity: NDArray[np.float64]) -> None:
        """Note a track: its position (3,) (m) and velocity (3,) (m/s) at a time (s) since the beginning."""
        self._tracks[name] = (time, position, velocity)

    def look(self, time: float, drones: NDArray[np.float64]) -> None:
        """Compare the newest tracks with the drones' positions (n, 3) (m)."""
        self._tracks = {name: each for name, each in self._tracks.items() if time - each[0] < SHOWN_S}
        for index, place in enumerate(drones):
            away = {name: float(np.linalg.norm(position + (time - told) * velocity - place))
                    for name, (told, position, velocity) in self._tracks.items()}
            hits = sorted((distance, name) for name, distance in away.items() if distance < HITS_M)
            cell = self._grid.cell_of(place)
            self.borders += self._cells[index] not in ((-1, -1), cell)
            self._cells[index] = cell
            self.looks, self.found, self.twice = self.looks + 1, self.found + bool(hits), self.twice + (len(hits) > 1)
            if hits and self._names[index] not in [name for _, name in hits]:
                self.changes += self._names[index] != 0
                self._names[index] = hits[0][1]
