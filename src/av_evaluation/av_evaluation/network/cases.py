"""The cases of the network's benchmark: rigs, drones, sensing and links."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from av_evaluation.network.simulation import NetworkSimulation, RigModel, SensingModel, Trajectory
from av_network.observation import RigSettings
from av_simulator.trajectories import RandomFlight

HEIGHT_M = 1.5  # of the rigs
SURVEYED = math.radians(0.1)  # standard deviation of a surveyed heading
TRIANGLE = ((-20.0, 0.0), (20.0, 0.0), (0.0, 35.0))  # m


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
