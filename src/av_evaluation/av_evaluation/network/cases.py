"""The cases of the network's benchmark: rigs, drones, sensing and links."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from av_evaluation.network.simulation import NetworkSimulation, RigModel, SensingModel, Trajectory
from av_network.observation import RigSettings
from av_simulator.trajectories import RandomFlight

HEIGHT_M = 1.5  # of the rigs
SURVEYED = math.radians(0.1)  # standard deviation of a surveyed heading
TRIANGLE = ((-20.0, 0.0), (20.0, 0.0), (0.0, 35.0))  # m
FLIGHT_STEP_S = 0.02  # of the integration of a flight
ACCELERATION = 5.0  # m/s^2, largest of a commanded change of velocity: camera drones accelerate by 3 to 6 m/s^2
LAG_S = 0.2  # time constant with which the attitude follows the command
FASTEST, EIGHT_SPEED = 12.0, 9.0  # m/s, with commands, and about the mean of eights
CAMERAS, PRESENCE = 5, 0.85  # their number, and the share of the time for which each measures the drone
CENTRE = np.array([0.0, 45.0, 18.0])  # m
EXTENT = np.array([22.0, 22.0, 8.0])  # m, half extents of the box in which it stays


def flight(center: Sequence[float], seed: int, extent: Sequence[float] = (18.0, 18.0, 4.0)) -> Trajectory:
    """A smooth random flight around a centre (m), of up to some 10 m/s and 3 m/s^2.

    Parameters:
        center (m): of the box.
        seed: of the flight.
        extent (m): half extents of the box.
    """
    x, y, z = center
    a, b, c = extent
    path = RandomFlight((x, y, z), (a, b, c), 14.0, seed)
    return lambda time: np.asarray(path(time)[0])


def two_rigs(seed: int, seen: float = 1.0) -> NetworkSimulation:
    """Two surveyed rigs 40 m apart and a drone at some 60 m from their midpoint.

    Parameters:
        seed: of flight and measurements.
        seen: probability that the drone is seen, and not only heard, by a rig.
    """
    rigs = [RigModel(name, (20.0 * sign, 0.0, HEIGHT_M)) for name, sign in (('a', -1.0), ('b', 1.0))]
    drone = flight((0.0, math.sqrt(60.0**2 - 15.0**2), HEIGHT_M + 15.0), seed, (12.0, 12.0, 4.0))
    return NetworkSimulation(rigs, [drone], 60.0, seed, SensingModel(seen=seen))


def five_drones(seed: int, presence: float = 0.5, drones: int = 5) -> NetworkSimulation:
    """Three surveyed rigs and drones that each measures for a part of the time, and false tracks.

    Parameters:
        seed: of all draws.
        presence: share of the time for which a drone is measured by a rig.
        drones: their number.
    """
    rigs = [RigModel(name, (*place, HEIGHT_M)) for name, place in zip('abc', TRIANGLE, strict=True)]
    return NetworkSimulation(rigs, _flights(seed, drones), 60.0, seed, SensingModel(presence=presence, clutter_rate=0.05))


def wrong_clocks(seed: int) -> NetworkSimulation:
    """Three rigs of which two clocks are 50 ms off, and all headings 3 deg, with random signs; `seed` is of all draws."""
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (3, 2))
    rigs = [RigModel(name, (*place, HEIGHT_M), math.radians(3.0) * sign[0], 0.0 if name == 'a' else 0.05 * sign[1])
            for name, place, sign in zip('abc', TRIANGLE, signs, strict=True)]
    return NetworkSimulation(rigs, _flights(seed, 5), 61.0, seed, SensingModel(seen=1.0))


def ring(seed: int, rigs: int, drones: int) -> NetworkSimulation:
    """Rigs on a circle of 60 m around drones.

    Parameters:
        seed: of all draws.
        rigs, drones: their numbers.
    """
    angles = math.tau * np.arange(rigs) / rigs
    models = [RigModel(f'rig{k}', (60.0 * math.cos(angle), 60.0 * math.sin(angle), HEIGHT_M)) for k, angle in enumerate(angles)]
    return NetworkSimulation(models, _flights(seed, drones, 50.0, 0.0), 30.0, seed, SensingModel(presence=0.7))


def settings_of(simulation: NetworkSimulation, heading_sigma: float = SURVEYED, clock_sigma: float = 0.001
                ) -> list[RigSettings]:
    """What is known beforehand of the rigs of a simulation; the first has the reference clock.

    Parameters:
        simulation: the rigs.
        heading_sigma (rad), clock_sigma (s): see `RigSettings`.
    """
    return [RigSettings(rig.name, heading_sigma, clock_sigma if index else 0.0)
            for index, rig in enumerate(simulation.rigs)]


def _flights(seed: int, count: int, spread: float = 35.0, north: float = 40.0) -> list[Trajectory]:
    random = np.random.default_rng(1000 + seed)
    return [flight((random.uniform(-spread, spread), north + random.uniform(-spread, spread), random.uniform(10.0, 30.0)),
                   100 * seed + drone) for drone in range(count)]


def stops_and_reversals(seed: int, duration: float) -> Trajectory:
    """A flight by commands of velocity: go, stop, turn back, after 0.8 to 4 s each.

    The multirotor follows them by accelerations of up to ACCELERATION, with the lag LAG_S.

    Parameters:
        seed: of the commands.
        duration (s): of the flight.
    """
    random, count = np.random.default_rng(seed), int(duration / FLIGHT_STEP_S) + 2
    places, wanted, until = np.zeros((count, 3)), np.zeros(3), 0.0
    place, velocity, acceleration = CENTRE, np.zeros(3), np.zeros(3)
    for k in range(count):
        if k * FLIGHT_STEP_S >= until:
            until += random.uniform(0.8, 4.0)
            kind = random.random()
            course = random.normal(size=3) * [1.0, 1.0, 0.3]
            course *= random.uniform(0.4, 1.0) * FASTEST / np.linalg.norm(course)
            wanted = np.zeros(3) if kind < 0.25 else -wanted if kind < 0.5 and np.any(wanted) else course
        outside = np.abs(place + velocity - CENTRE) > EXTENT
        wanted = np.where(outside, -np.sign(place - CENTRE) * np.maximum(np.abs(wanted), 3.0), wanted)
        change = (wanted - velocity) / 0.3
        change *= min(1.0, ACCELERATION / max(float(np.linalg.norm(change)), 1e-9))
        acceleration = acceleration + (change - acceleration) * FLIGHT_STEP_S / LAG_S
        velocity, place = velocity + acceleration * FLIGHT_STEP_S, place + velocity * FLIGHT_STEP_S
        places[k] = place
    return _interpolated(places)


def figure_of_eight(seed: int, duration: float) -> Trajectory:
    """Eights of some 14 m, banked, with up to 6 m/s^2 to the side, that wander slowly.

    Parameters:
        seed: of size, course and height.
        duration (s): of the flight.
    """
    random, times = np.random.default_rng(seed), np.arange(0.0, duration + 2.0 * FLIGHT_STEP_S, FLIGHT_STEP_S)
    size, turn = random.uniform(12.0, 18.0), random.uniform(0.0, math.tau)
    phase = EIGHT_SPEED / (1.3 * size) * times + random.uniform(0.0, math.tau)
    x, y = size * np.sin(phase), 0.5 * size * np.sin(2.0 * phase)
    drift = 5.0 * np.stack([np.sin(0.11 * times), np.cos(0.13 * times), 0.6 * np.sin(0.37 * times)], 1)
    level = np.stack([x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn), np.zeros_like(x)], 1)
    return _interpolated(CENTRE + drift + level)


def _interpolated(places: NDArray[np.float64]) -> Trajectory:
    times = FLIGHT_STEP_S * np.arange(len(places))
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
