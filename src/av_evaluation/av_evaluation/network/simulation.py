"""Reports of several rigs about drones, as their filters would send them, over a network that loses and delays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap
from av_network import sphere
from av_network.motion_model import nearly_constant_velocity
from av_network.report import Report, Sighting

Trajectory = Callable[[float], NDArray[np.float64]]


@dataclass(frozen=True)
class RigModel:
    """A rig of the simulation.

    Parameters:
        name: its name.
        position (m): ENU.
        heading_error (rad): to be added to what the rig reports to get true azimuths.
        clock_offset (s): to be added to the rig's stamps to get the true time.
    """

    name: str
    position: tuple[float, float, float]
    heading_error: float = 0.0
    clock_offset: float = 0.0


@dataclass(frozen=True)
class SensingModel:
    """What a rig measures of a drone, and how it filters that.

    Sound gives white errors that have the spectral density of those of the rig's overlapping windows.

    Parameters:
        rate (Hz): of the measurements.
        sound_sigma (2,), sight_sigma (2,) (rad): of the azimuth (times cos(elevation)) and of the elevation.
        density (rad^2/s^3): of the angular acceleration in the rig's filter.
        report_period (s): between two reports of a rig.
        presence: share of the time for which a drone is measured by a rig.
        dwell (s): mean duration of the spells for which it is.
        seen: probability that it is seen, and not only heard, in such a spell.
        clutter_rate (Hz): of false tracks of each rig, which last for 1 s on average.
        sound_speed (m/s): speed of sound.
    """

    rate: float = 10.0
    sound_sigma: tuple[float, float] = (math.radians(3.0), math.radians(5.0))
    sight_sigma: tuple[float, float] = (math.radians(0.5), math.radians(0.5))
    density: float = 0.001
    report_period: float = 0.25
    presence: float = 1.0
    dwell: float = 3.0
    seen: float = 0.5
    clutter_rate: float = 0.0
    sound_speed: float = 343.2


@dataclass(frozen=True)
class LinkModel:
    """The network between the rigs and the node that tracks.

    Parameters:
        delay (s), jitter (s): least delay of a message, and mean of what comes on top.
        loss: probability that a message is lost.
        partition (s): beginning and end of a time without messages from `parted`.
        parted: names of the rigs on the other side.
    """

    delay: float = 0.01
    jitter: float = 0.005
    loss: float = 0.0
    partition: tuple[float, float] = (math.inf, math.inf)
    parted: tuple[str, ...] = ()


class Arrival(NamedTuple):
    """A report that arrives at `time` (s)."""

    time: float
    report: Report


class _DirectionFilter:
    """A rig's Kalman filter of one target: its direction on the sphere, and the rate of that, as in the rigs' own filters.

    Parameters:
        angles (2,) (rad): azimuth and elevation of the first measurement.
        variances (2,) (rad^2): of its error across and up.
        density (rad^2/s^3): of the angular acceleration.
    """

    def __init__(self, angles: NDArray[np.float64], variances: NDArray[np.float64], density: float) -> None:
        self.angles, self._rates = angles, np.zeros(3)
        self._P = np.array([np.diag([variance, 0.3**2]) for variance in variances])
        self._density = density

    def predict(self, step: float) -> None:
        F, Q = nearly_constant_velocity(step, self._density)
        ahead = sphere.moved(self.angles, step * self._rates)
        self._rates, self.angles = sphere.carried(self._rates, self.angles, ahead), ahead
        self._P = F @ self._P @ F.T + Q

    def update(self, angles: NDArray[np.float64], variances: NDArray[np.float64]) -> None:
        ahead = self.angles
        residual = sphere.offsets(angles, ahead)
        gain = self._P[:, :, 0] / (self._P[:, 0, 0] + variances)[:, None]
        self.angles = sphere.moved(ahead, sphere.vectors(gain[:, 0] * residual, ahead))
        rates = self._rates + sphere.vectors(gain[:, 1] * residual, ahead)
        self._rates = sphere.carried(rates, ahead, self.angles)
        self._P = self._P - gain[:, :, None] * self._P[:, None, 0, :]

    @property
    def variances(self) -> NDArray[np.float64]:
        return self._P[:, 0, 0]


@dataclass
class _Spell:
    """A time for which a rig tracks a drone under one id."""

    id: int
    seen: bool
    filter: _DirectionFilter | None = None
    measured: float = 0.0


@dataclass
class NetworkSimulation:
    """Draws the reports of rigs about drones.

    Parameters:
        rigs: the rigs.
        drones: position (3,) (m) of each by the time (s).
        duration (s): of the run.
        seed: of all draws.
        sensing: see `SensingModel`.
        link: see `LinkModel`.

    Attributes:
        origins: the drone (index) behind each track (name of the rig, id) of the reports drawn so far that is not false.
    """

    rigs: Sequence[RigModel]
    drones: Sequence[Trajectory]
    duration: float
    seed: int = 1
    sensing: SensingModel = SensingModel()
    link: LinkModel = LinkModel()
    origins: dict[tuple[str, int], int] = field(init=False, default_factory=dict)
    _random: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def arrivals(self) -> list[Arrival]:
        """All reports that arrive, in the order of arrival."""
        found = [arrival for rig in self.rigs for arrival in self._reports(rig)]
        return sorted(found, key=lambda arrival: arrival.time)

    def truth(self, time: float) -> NDArray[np.float64]:
        """Positions (n, 3) (m) of the drones at a time (s)."""
        return np.array([drone(time) for drone in self.drones]).reshape(-1, 3)

    def _reports(self, rig: RigModel) -> list[Arrival]:
        sensing, random, step = self.sensing, self._random, 1.0 / self.sensing.rate
        phase, due = random.uniform(0.0, step), random.uniform(0.0, sensing.report_period)
        spells: dict[int, _Spell] = {}
        false: list[_Spell] = []
        names = iter(range(1, 10**6))
        found: list[Arrival] = []
        steps = int(self.duration / step)
        for time in phase + step * np.arange(steps):
            self._begin_and_end(spells, names, step)
            for drone, spell in spells.items():
                self._measure(rig, spell, self.drones[drone], float(time), step)
                self.origins[rig.name, spell.id] = drone
            false = self._false_tracks(false, names, float(time), step)
            if time >= due:
                due += sensing.report_period
                alive = [spell for spell in (*spells.values(), *false) if spell.filter is not None]
                found += self._send(rig, float(time), alive)
        return found

    def _begin_and_end(self, spells: dict[int, _Spell], names: Iterator[int], step: float) -> None:
        """Two-state Markov chains with the stationary share `presence`."""
        sensing = self.sensing
        away = sensing.dwell * (1.0 - sensing.presence) / max(sensing.presence, 1e-9)
        for drone in range(len(self.drones)):
            if drone in spells:
                if sensing.presence < 1.0 and self._random.random() < step / sensing.dwell:
                    del spells[drone]
            elif away == 0.0 or self._random.random() < step / away:
                spells[drone] = _Spell(next(names), self._random.random() < sensing.seen)

    def _false_tracks(self, spells: list[_Spell], names: Iterator[int], time: float, step: float) -> list[_Spell]:
        kept = [spell for spell in spells if self._random.random() > step]
        for spell in kept:
            self._follow(spell, spell.filter.angles if spell.filter else np.zeros(2), time, step)
        for _ in range(self._random.poisson(self.sensing.clutter_rate * step)):
            spell = _Spell(next(names), False)
            self._follow(spell, np.array([self._random.uniform(-math.pi, math.pi), self._random.uniform(0.0, 0.6)]), time, step)
            kept.append(spell)
        return kept

    def _measure(self, rig: RigModel, spell: _Spell, drone: Trajectory, time: float, step: float) -> None:
        """Where the drone was when it emitted what is received at `time`, by fixed-point iteration."""
        origin, emitted = np.array(rig.position), time
        for _ in range(0 if spell.seen else 4):
            emitted = time - float(np.linalg.norm(drone(emitted) - origin)) / self.sensing.sound_speed
        offset = drone(emitted) - origin
        azimuth = math.atan2(offset[1], offset[0]) - rig.heading_error
        self._follow(spell, np.array([azimuth, math.atan2(offset[2], math.hypot(offset[0], offset[1]))]), time, step)

    def _follow(self, spell: _Spell, angles: NDArray[np.float64], time: float, step: float) -> None:
        sensing = self.sensing
        sigmas = np.array(sensing.sight_sigma if spell.seen else sensing.sound_sigma)
        measured = sphere.moved(angles, sphere.vectors(sigmas * self._random.normal(size=2), angles))
        if spell.filter is None:
            spell.filter = _DirectionFilter(measured, sigmas**2, sensing.density)
        else:
            spell.filter.predict(step)
            spell.filter.update(measured, sigmas**2)
        spell.measured = time

    def _send(self, rig: RigModel, time: float, spells: Sequence[_Spell]) -> list[Arrival]:
        link, random = self.link, self._random
        begin, end = link.partition
        arrives = time + link.delay + random.exponential(link.jitter)
        if random.random() < link.loss or (rig.name in link.parted and begin <= arrives < end):
            return []
        sightings = []
        for spell in spells:
            assert spell.filter is not None
            azimuth, elevation = (float(angle) for angle in spell.filter.angles)
            sightings.append(Sighting(spell.id, float(wrap(azimuth)), elevation, np.diag(spell.filter.variances),
                                      spell.measured - rig.clock_offset, not spell.seen))
        return [Arrival(arrives, Report(rig.name, time - rig.clock_offset, np.array(rig.position), tuple(sightings)))]
