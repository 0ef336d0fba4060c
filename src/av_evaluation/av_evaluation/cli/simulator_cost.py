"""`ros2 run av_evaluation simulator_cost [SCENARIO ...]`: time of a second of sound and of an image on this machine."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Callable

import cv2
import numpy as np

from av_simulator.config_files import find_config, shipped
from av_simulator.run import BLOCKS_PER_SECOND, open_world
from av_simulator.world import World


def main(arguments: list[str] | None = None) -> int:
    """Print a table. Returns the exit code: 0, or 2 for an unreadable scenario."""
    parser = argparse.ArgumentParser(prog='simulator_cost', description=__doc__)
    parser.add_argument('scenarios', nargs='*', help='names of shipped scenarios, or files (default: all shipped ones)')
    parser.add_argument('--seconds', type=float, default=4.0, help='duration of sound for each scenario (default: %(default)s)')
    parser.add_argument('--images', type=int, default=30, help='number of images for each scenario (default: %(default)s)')
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    print(f'{"scenario":20s} {"sound: work per s":>18s} {"image: work":>14s} {"alone":>12s}')
    try:
        for name in options.scenarios or shipped('scenarios'):
            world = open_world(find_config(name, 'scenarios'))
            sound = _sound(world, options.seconds)
            image, wall = _image(world, options.images)
            print(f'{world.scenario.name:20s} {sound:16.3f} s {1e3 * image:11.1f} ms {1 / wall:8.1f} fps', flush=True)
    except (ValueError, OSError) as error:
        print(f'simulator_cost: {error}', file=sys.stderr)
        return 2
    return 0


def _sound(world: World, seconds: float) -> float:
    """Processor time (s) for one second of sound, after a second of warm-up."""
    block = world.sample_rate // BLOCKS_PER_SECOND

    def advance() -> None:
        world.advance(block)

    _measured(advance, BLOCKS_PER_SECOND)
    return _measured(advance, int(seconds * BLOCKS_PER_SECOND))[0] * BLOCKS_PER_SECOND


def _image(world: World, count: int) -> tuple[float, float]:
    """Processor and wall time (s) for one image with the first drone in the middle, including JPEG compression."""
    renderer = world.renderer()
    # Turn the rig to the drone: the most expensive case, since its visible part is computed, too.
    rig = world.rig_state(world.time)
    east, north, _ = world.scenario.targets[0].trajectory(world.time)[0] - rig.position
    half = np.arctan2(north, east) / 2
    world.dynamics.follow(dataclasses.replace(rig, attitude_wxyz=np.array([np.cos(half), 0.0, 0.0, np.sin(half)])))
    for _ in range(2):    # one block to turn, one to come to rest
        world.advance(world.sample_rate // BLOCKS_PER_SECOND)
    view = world.view(0, world.time)

    def render() -> None:
        cv2.imencode('.jpg', renderer.render(view).bgr)

    _measured(render, 3)
    cost = _measured(render, count)
    renderer.close()
    return cost


def _measured(work: Callable[[], None], times: int) -> tuple[float, float]:
    """Processor and wall time (s) of one call."""
    processor, wall = time.process_time(), time.perf_counter()
    for _ in range(times):
        work()
    return (time.process_time() - processor) / times, (time.perf_counter() - wall) / times


if __name__ == '__main__':
    sys.exit(main())
