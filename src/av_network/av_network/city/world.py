"""Simulated rigs and drones of a city."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from av_common.stamps import to_stamp
from av_interfaces.msg import RigReport, TargetDirection
from av_network.city.cell import Grid

SIGMA = math.radians(0.5)  # of a direction in a report
HEADING_SIGMA = math.radians(0.2)  # of the surveyed headings
PRESENCE = 0.9  # probability that a report has a drone within reach
RIG_M, DRONE_M = 3.0, 40.0  # heights
LOOK_S = 0.5
HITS_M, SHOWN_S = 10.0, 1.0  # farthest from a drone, and oldest, that a track of it is


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
            x, y, z = offsets[drone]
            elevation = math.atan2(z, math.hypot(x, y))
            across, up = SIGMA * self._random.normal(size=2)
            message.directions.append(TargetDirection(
                id=int(drone) + 1, azimuth=math.atan2(y, x) + across / math.cos(elevation) - self._headings[rig],
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
