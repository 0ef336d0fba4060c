"""Simulation of a world as fast as possible: for files, notebooks and training.

>>> for step in steps(open_world('fog_woodland', seed=3), duration=10.0):
...     step.sound     # (samples, microphones) float32, from step.begin to step.end
...     step.images    # [(view, image), ...] within that interval
...     step.truth     # [TruthSample, ...]
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from av_common.angles import direction_to_angles
from av_common.rig import load_rig
from av_sim_bridge.vehicle import VehicleState
from av_sim_bridge.wire.gimbal import GimbalSample
from av_simulator.config_files import find_config
from av_simulator.rendering.view import RenderedImage, View
from av_simulator.scenario import Scenario, load_scenario
from av_simulator.world import World

BLOCKS_PER_SECOND = 30  # as RFlySim sends sound
TRUTH_RATE = 100  # Hz, of true states, inertial measurements and orientations of the gimbal


@dataclass(frozen=True)
class Bearing:
    """Direction and distance of a target in the rig's body frame.

    Parameters:
        azimuth (rad): counter-clockwise from the x axis.
        elevation (rad): upwards from the x-y plane.
        distance (m): distance from the origin of the body frame.
    """

    azimuth: float
    elevation: float
    distance: float


@dataclass(frozen=True)
class TruthSample:
    """The true states of rig and targets at one time.

    Parameters:
        time (s): time of the states.
        rig: state of the rig.
        targets: state of each target.
        gimbal: what the gimbal reports; None without one.
    """

    time: float
    rig: VehicleState
    targets: list[VehicleState]
    gimbal: GimbalSample | None = None

    @property
    def bearings(self) -> list[Bearing]:
        """Direction and distance of each target in the rig's body frame."""
        away = [(target.position - self.rig.position) @ self.rig.rotation for target in self.targets]
        angles = [direction_to_angles(vector) for vector in away]
        return [Bearing(float(azimuth), float(elevation), float(np.linalg.norm(vector)))
                for (azimuth, elevation), vector in zip(angles, away, strict=True)]


@dataclass(frozen=True)
class Step:
    """Output of one simulation step.

    Parameters:
        begin, end (s): interval of the step.
        sound ((samples, microphones), float32): samples, full scale 1.
        images: views within the step, with their images.
        truth: true states within the step.
    """

    begin: float
    end: float
    sound: NDArray
    images: list[tuple[View, RenderedImage]]
    truth: list[TruthSample]


def open_world(scenario: str | Path | Scenario, rig: str | Path = '', seed: int | None = None) -> World:
    """The world of a scenario. Raises ConfigError or OSError for unreadable files.

    Parameters:
        scenario: name of a shipped scenario, path of a file, or a Scenario.
        rig: name or path of the rig's description; empty for the scenario's.
        seed: seed, None for the scenario's.
    """
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(find_config(str(scenario), 'scenarios'))
    return World(scenario, load_rig(find_config(str(rig or scenario.rig.description))), seed)


def steps(world: World, duration: float | None = None, image_rate: float = 15.0, truth_rate: float = TRUTH_RATE,
          everything: bool = False, renderer: str = 'auto') -> Iterator[Step]:
    """Simulate a world in steps of 1/30 s.

    Between steps, `world.dynamics.command(yaw_rate, world.time)` turns the rig.

    Parameters:
        world: the world, at its beginning.
        duration (s): simulated time, None for the scenario's.
        image_rate (Hz): rate of the images, 0 for none.
        truth_rate (Hz): rate of the true states.
        everything: whether segmentation and thermal image are rendered.
        renderer: kind of renderer, see `make_renderer`.
    """
    duration = world.scenario.duration if duration is None else duration
    camera = world.renderer_factory()(kind=renderer, everything=everything) if image_rate else None
    try:
        while world.time < duration - 1e-9:
            begin = world.time
            sound = world.advance(world.sample_rate // BLOCKS_PER_SECOND)
            views = [world.view(round(time * image_rate), time) for time in times(begin, world.time, image_rate)]
            at = times(begin, world.time, truth_rate)
            targets = [world.target_states(number, at) for number in range(len(world.scenario.targets))]
            gimbal = [world.gimbal_sample(round(time * world.sample_rate), time) for time in at]
            truth = [TruthSample(time, world.rig_state(time), states, measured)
                     for time, measured, *states in zip(at, gimbal, *targets, strict=True)]
            yield Step(begin, world.time, sound, [(view, camera.render(view)) for view in views] if camera else [], truth)
    finally:
        if camera is not None:
            camera.close()


def times(begin: float, end: float, rate: float) -> list[float]:
    """Multiples of 1/rate in the interval (begin, end] (s), none for a rate (Hz) of 0."""
    if not rate:
        return []
    first, last = int(begin * rate + 1e-6) + 1, int(end * rate + 1e-6)
    return [number / rate for number in range(first, last + 1)]
