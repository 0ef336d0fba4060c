"""Reports of several rigs about drones, as they would send them, over a network that loses and delays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap
from av_fusion.rig_reporter import REPORT_PERIOD_S
from av_network import sphere
from av_network.observation import Report, Sighting

LASTING_S, SOUND_SPEED = 2.0, 343.2  # of lasting errors; m/s
Trajectory = Callable[[float], NDArray[np.float64]]


@dataclass(frozen=True)
class SensingModel:
    """What a rig measures of a drone, and how often it reports that.

    Sound gives white errors that have the spectral density of those of the rig's overlapping windows.

    Parameters:
        rate (Hz): of the measurements.
        sound_sigma (2,), sight_sigma (2,) (rad): of the azimuth (times cos(elevation)) and of the elevation.
        presence: share of the time for which a drone is measured by a rig.
        dwell (s): mean duration of the spells for which it is.
        seen: probability that it is seen, and not only heard, in such a spell.
        clutter_rate (Hz): of false tracks of each rig, which last for 1 s on average.
        lasting (rad): standard deviation of an error along each axis that is not stated, of a calibration or of a box,
            which falls to 1 / e of itself in LASTING_S.
    """

    rate: float = 10.0
    sound_sigma: tuple[float, float] = (math.radians(3.0), math.radians(5.0))
    sight_sigma: tuple[float, float] = (math.radians(0.5), math.radians(0.5))
    presence: float = 1.0
    dwell: float = 3.0
    seen: float = 0.5
    clutter_rate: float = 0.0
    lasting: float = 0.0


@dataclass(frozen=True)
class RigModel:
    """A rig of the simulation.

    Parameters:
        name: its name.
        position (m): ENU.
        heading_error (rad): to be added to what the rig reports to get true azimuths.
        clock_offset (s): to be added to the rig's stamps to get the true time.
        sensing: its own; None for that of the simulation.
    """

    name: str
    position: tuple[float, float, float]
    heading_error: float = 0.0
    clock_offset: float = 0.0
    sensing: SensingModel | None = None


@dataclass(frozen=True)
class LinkModel:
    """The network between the rigs and the node that tracks.

    Parameters:
        delay (s), jitter (s): least delay of a message, and mean of what comes on top.
        loss: probability that a message is lost.
    """

    delay: float = 0.01
    jitter: float = 0.005
    loss: float = 0.0


class Arrival(NamedTuple):
    """A report that arrives at `time` (s)."""

    time: float
    report: Report


@dataclass
class _Spell:
    """A time for which a rig tracks a drone under one id, and what it has measured since its last report.

    Parameters:
        id: of the rig's track.
        seen: whether it sees the drone.
        sigmas (2,) (rad): of its measurements.
        truth (2,) (rad): azimuth and elevation of its newest measurement, without the error.
        times (s), measured (2,) (rad): of its measurements since the last report.
        error (2,) (rad), erred (s): the error that lasts, and when.
    """

    id: int
    seen: bool
    sigmas: NDArray[np.float64]
    truth: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    times: list[float] = field(default_factory=list)
    measured: list[NDArray[np.float64]] = field(default_factory=list)
    error: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    erred: float = -math.inf


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
    """

    rigs: Sequence[RigModel]
    drones: Sequence[Trajectory]
    duration: float
    seed: int = 1
    sensing: SensingModel = SensingModel()
    link: LinkModel = LinkModel()
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
        sensing, random = rig.sensing or self.sensing, self._random
        step = 1.0 / sensing.rate
        phase, due = random.uniform(0.0, step), random.uniform(0.0, REPORT_PERIOD_S)
        spells: dict[int, _Spell] = {}
        false: list[_Spell] = []
        names = iter(range(1, 10**6))
        found: list[Arrival] = []
        steps = int(self.duration / step)
        for time in phase + step * np.arange(steps):
            self._begin_and_end(sensing, spells, names)
            for drone, spell in spells.items():
                self._measure(rig, spell, self.drones[drone], float(time))
            false = self._false_tracks(sensing, false, names, float(time))
            if time >= due:
                due += REPORT_PERIOD_S
                found += self._send(rig, float(time), [spell for spell in (*spells.values(), *false) if spell.times])
        return found

    def _begin_and_end(self, sensing: SensingModel, spells: dict[int, _Spell], names: Iterator[int]) -> None:
        """Two-state Markov chains with the stationary share `presence`."""
        step = 1.0 / sensing.rate
        away = sensing.dwell * (1.0 - sensing.presence) / max(sensing.presence, 1e-9)
        for drone in range(len(self.drones)):
            if drone in spells:
                if sensing.presence < 1.0 and self._random.random() < step / sensing.dwell:
                    del spells[drone]
            elif away == 0.0 or self._random.random() < step / away:
                seen = self._random.random() < sensing.seen
                spells[drone] = _Spell(next(names), seen, np.array(sensing.sight_sigma if seen else sensing.sound_sigma))

    def _false_tracks(self, sensing: SensingModel, spells: list[_Spell], names: Iterator[int], time: float) -> list[_Spell]:
        step = 1.0 / sensing.rate
        kept = [spell for spell in spells if self._random.random() > step]
        for spell in kept:
            self._follow(spell, spell.truth, time)
        for _ in range(self._random.poisson(sensing.clutter_rate * step)):
            spell = _Spell(next(names), False, np.array(sensing.sound_sigma))
            self._follow(spell, np.array([self._random.uniform(-math.pi, math.pi), self._random.uniform(0.0, 0.6)]), time)
            kept.append(spell)
        return kept

    def _measure(self, rig: RigModel, spell: _Spell, drone: Trajectory, time: float) -> None:
        """Where the drone was when it emitted what is received at `time`, by fixed-point iteration."""
        origin, emitted = np.array(rig.position), time
        for _ in range(0 if spell.seen else 4):
            emitted = time - float(np.linalg.norm(drone(emitted) - origin)) / SOUND_SPEED
        offset = drone(emitted) - origin
        azimuth, sensing = math.atan2(offset[1], offset[0]) - rig.heading_error, rig.sensing or self.sensing
        if sensing.lasting:
            kept = math.exp((spell.erred - time) / LASTING_S)
            fresh = sensing.lasting * math.sqrt(1.0 - kept**2) * self._random.normal(size=2)
            spell.error, spell.erred = kept * spell.error + fresh, time
        self._follow(spell, np.array([azimuth, math.atan2(offset[2], math.hypot(offset[0], offset[1]))]), time)

    def _follow(self, spell: _Spell, angles: NDArray[np.float64], time: float) -> None:
        spell.truth = angles
        spell.times.append(time)
        spell.measured.append(sphere.moved(angles, spell.error + spell.sigmas * self._random.normal(size=2)))

    def _send(self, rig: RigModel, time: float, spells: Sequence[_Spell]) -> list[Arrival]:
        link, random = self.link, self._random
        arrives = time + link.delay + random.exponential(link.jitter)
        sightings = [self._sighting(rig, spell) for spell in spells]
        if random.random() < link.loss:
            return []
        newest = max((one.measured for one in sightings), default=time - rig.clock_offset)
        return [Arrival(arrives, Report(rig.name, newest, np.array(rig.position), tuple(sightings)))]

    def _sighting(self, rig: RigModel, spell: _Spell) -> Sighting:
        """The mean of the measurements since the last report, at their mean time."""
        measured, centre = np.array(spell.measured), spell.measured[len(spell.measured) // 2]
        arc = np.mean(sphere.offsets(measured, centre), axis=0)
        azimuth, elevation = map(float, sphere.moved(centre, arc))
        covariance, time = np.diag(spell.sigmas ** 2) / len(measured), float(np.mean(spell.times))
        spell.times, spell.measured = [], []
        return Sighting(spell.id, float(wrap(azimuth)), elevation, covariance, time - rig.clock_offset, not spell.seen)
