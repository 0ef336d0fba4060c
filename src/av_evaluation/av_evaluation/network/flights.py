"""Flights as hard as multirotors fly, cameras that measure them, and plain least squares on what those report."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_evaluation.network.figures import OwnTracker
from av_evaluation.network.simulation import NetworkSimulation, RigModel, SensingModel, Trajectory
from av_network import sphere
from av_network.observation import Report

STEP_S = 0.02  # of the integration of a flight
ACCELERATION = 5.0  # m/s^2, largest of a commanded change of velocity: camera drones accelerate by 3 to 6 m/s^2
LAG_S = 0.2  # time constant with which the attitude follows the command
FASTEST, EIGHT_SPEED = 12.0, 9.0  # m/s, with commands, and about the mean of eights
CAMERAS, PRESENCE = 5, 0.85  # their number, and the share of the time for which each measures the drone
CENTRE = np.array([0.0, 45.0, 18.0])  # m
EXTENT = np.array([22.0, 22.0, 8.0])  # m, half extents of the box in which it stays
WINDOW_S = 0.8  # of the reports that are used by least squares: each camera has two or three, at four a second


def stops_and_reversals(seed: int, duration: float) -> Trajectory:
    """A flight by commands of velocity: go, stop, turn back, after 0.8 to 4 s each.

    The multirotor follows them by accelerations of up to ACCELERATION, with the lag LAG_S.

    Parameters:
        seed: of the commands.
        duration (s): of the flight.
    """
    random, count = np.random.default_rng(seed), int(duration / STEP_S) + 2
    places, wanted, until = np.zeros((count, 3)), np.zeros(3), 0.0
    place, velocity, acceleration = CENTRE, np.zeros(3), np.zeros(3)
    for k in range(count):
        if k * STEP_S >= until:
            until += random.uniform(0.8, 4.0)
            kind = random.random()
            course = random.normal(size=3) * [1.0, 1.0, 0.3]
            course *= random.uniform(0.4, 1.0) * FASTEST / np.linalg.norm(course)
            wanted = np.zeros(3) if kind < 0.25 else -wanted if kind < 0.5 and np.any(wanted) else course
        outside = np.abs(place + velocity - CENTRE) > EXTENT
        wanted = np.where(outside, -np.sign(place - CENTRE) * np.maximum(np.abs(wanted), 3.0), wanted)
        change = (wanted - velocity) / 0.3
        change *= min(1.0, ACCELERATION / max(float(np.linalg.norm(change)), 1e-9))
        acceleration = acceleration + (change - acceleration) * STEP_S / LAG_S
        velocity, place = velocity + acceleration * STEP_S, place + velocity * STEP_S
        places[k] = place
    return _interpolated(places)


def figure_of_eight(seed: int, duration: float) -> Trajectory:
    """Eights of some 14 m, banked, with up to 6 m/s^2 to the side, that wander slowly.

    Parameters:
        seed: of size, course and height.
        duration (s): of the flight.
    """
    random, times = np.random.default_rng(seed), np.arange(0.0, duration + 2.0 * STEP_S, STEP_S)
    size, turn = random.uniform(12.0, 18.0), random.uniform(0.0, math.tau)
    phase = EIGHT_SPEED / (1.3 * size) * times + random.uniform(0.0, math.tau)
    x, y = size * np.sin(phase), 0.5 * size * np.sin(2.0 * phase)
    drift = 5.0 * np.stack([np.sin(0.11 * times), np.cos(0.13 * times), 0.6 * np.sin(0.37 * times)], 1)
    level = np.stack([x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn), np.zeros_like(x)], 1)
    return _interpolated(CENTRE + drift + level)


def _interpolated(places: NDArray[np.float64]) -> Trajectory:
    times = STEP_S * np.arange(len(places))
    return lambda time: np.array([np.interp(time, times, axis) for axis in places.T])


FLIGHTS = {'reversals': stops_and_reversals, 'eight': figure_of_eight}


def cameras(seed: int, kind: str, duration: float = 60.0, lasting: float = 0.0, heading: float = 0.0) -> NetworkSimulation:
    """Cameras of different rates and precision around a hard flight, with drop-outs and clocks that are off by some ms.

    Parameters:
        seed: of all draws.
        kind: of `FLIGHTS`.
        duration (s): of the run.
        lasting (rad): standard deviation of errors of some seconds that the cameras do not state.
        heading (rad): standard deviation of the errors of their headings.
    """
    random, rigs = np.random.default_rng(7000 + seed), []
    for index in range(CAMERAS):
        angle, sigma = math.tau * (index + random.uniform(-0.3, 0.3)) / CAMERAS, math.radians(random.uniform(0.1, 0.5))
        place = CENTRE[:2] + random.uniform(35.0, 55.0) * np.array([math.cos(angle), math.sin(angle)])
        sensing = SensingModel(float(random.choice([10.0, 15.0, 25.0, 30.0, 60.0])), sight_sigma=(sigma, sigma),
                               presence=PRESENCE, dwell=6.0, seen=1.0, lasting=lasting)
        height, turned = random.uniform(0.5, 6.0), random.normal(0.0, heading) if heading else 0.0
        rigs.append(RigModel(f'cam{index + 1}', (float(place[0]), float(place[1]), height), turned,
                             random.normal(0.0, 0.01) if index else 0.0, sensing))
    return NetworkSimulation(rigs, [FLIGHTS[kind](seed, duration)], duration, seed)


class Fit(NamedTuple):
    """A position (3,) (m) by least squares, at a time (s)."""

    time: float
    position: NDArray[np.float64]


def least_squares(reports: Sequence[Report], now: float) -> Fit | None:
    """Where a drone in uniform motion fits the directions of the last WINDOW_S best, at the newest time of these.

    Gauss-Newton from where the lines meet, without any prior; None where fewer than two rigs have two directions. Clocks and
    headings are taken for right.

    Parameters:
        reports: of one drone, that have arrived.
        now (s): the present.
    """
    used = [(report, one) for report in reports for one in report.sightings if now - one.measured < WINDOW_S]
    if sum(count > 1 for count in Counter(report.rig for report, _ in used).values()) < 2:
        return None
    places, times = np.array([report.position for report, _ in used]), np.array([one.measured for _, one in used])
    angles = np.array([(one.azimuth, one.elevation) for _, one in used])
    across = sphere.axes(angles)  # (k, 2, 3)
    time, distances = float(np.max(times)), np.ones(len(used))
    for _ in range(4):
        weights = 1.0 / (distances * np.sqrt([one.covariance[0, 0] for _, one in used]))
        rows = np.concatenate([across, (times - time)[:, None, None] * across], 2) * weights[:, None, None]
        values = np.einsum('kij,kj->ki', across, places) * weights[:, None]
        state = np.linalg.lstsq(rows.reshape(-1, 6), values.reshape(-1), rcond=None)[0]
        distances = np.maximum(np.linalg.norm(state[:3] - places, axis=1), 1.0)
    return Fit(time, state[:3])


class FlightFigures(NamedTuple):
    """How well a drone is followed that two rigs or more measure.

    Parameters:
        rmse (m): of the tracker for the time of the newest direction that it has used.
        squares (m): of `least_squares` at the same steps.
        present (m): of the tracker for the present, which is later.
        coverage: share of the steps at which two rigs or more measure it with a position.
        nees: mean normalised estimation error squared of the position, 3 being expected.
        names: number of ids.
    """

    rmse: float
    squares: float
    present: float
    coverage: float
    nees: float
    names: int


def follow(peer: OwnTracker, simulation: NetworkSimulation, settled: float = 3.0) -> FlightFigures:
    """Run a tracker on a flight of one drone.

    Parameters:
        peer: the tracker.
        simulation: the flight.
        settled (s): beginning, which is not counted.
    """
    waiting, arrived, names, rows = simulation.arrivals()[::-1], [], set(), []
    both = reported = 0
    for now in np.arange(0.1, simulation.duration, 0.1).tolist():
        while waiting and waiting[-1].time <= now:
            arrived.append(waiting.pop().report)
            peer.take(arrived[-1])
        found = peer.estimates(now)
        names |= {one.target.id for one in found}
        fit = least_squares(arrived[-40:], now)
        if fit is None or now < settled:
            continue
        both, reported = both + 1, reported + bool(found)
        if found:
            latest = peer.tracker.filter.time or 0.0
            state = next(each for each in peer.tracker.states(latest) if each.target.id == found[0].target.id)
            error, ahead = (state.mean[:3] - simulation.truth(latest)[0], found[0].mean[:3] - simulation.truth(now)[0])
            rows.append((error @ error, np.sum((fit.position - simulation.truth(fit.time)[0]) ** 2), ahead @ ahead,
                         ahead @ np.linalg.solve(found[0].covariance[:3, :3], ahead)))
    squared, fitted, ahead, nees = np.mean(rows, axis=0) if rows else np.full(4, math.nan)
    return FlightFigures(math.sqrt(squared), math.sqrt(fitted), math.sqrt(ahead), reported / max(both, 1), float(nees),
                         len(names))
