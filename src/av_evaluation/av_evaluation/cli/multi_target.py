"""ros2 run av_evaluation multi_target SCENARIO...: the filter of several targets on simulated measurements."""

from __future__ import annotations

import argparse
import time as wall
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from av_common.arguments import number, whole
from av_evaluation.experiments.measurement_simulation import MeasurementSimulation
from av_evaluation.metrics.tracks import TrackComparison
from av_evaluation.runs.program import processes, run_program
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.measurement.vectors import direction
from av_fusion.tracks.filter import MultiBernoulliFilter
from av_fusion.tracks.settings import FilterSettings
from av_simulator.config_files import find_config
from av_simulator.scenario import load_scenario

SCENARIOS = ('crossing', 'swarm_5', 'birds_and_drones', 'swarm_10')
BIRDS = {'birds_and_drones': 6}  # around the rig, by scenario


def run(scenario_name: str, pair: bool, alike: bool, seed: int) -> tuple[float, ...]:
    """Figures of a rig that stands still.

    Those of `TrackFigures`, and the filter's processor time over the duration of the run in percent.

    Parameters:
        scenario_name: its name or file.
        pair: whether the microphones are a pair.
        alike: whether all targets are of the type of the first.
        seed: of the measurements.
    """
    scenario, settings, motion = load_scenario(find_config(scenario_name, 'scenarios')), FilterSettings(), RigMotion()
    if alike:
        first = scenario.targets[0]
        scenario = replace(scenario, targets=tuple(replace(target, drone=first.drone, signal=first.signal)
                                                   for target in scenario.targets))
    simulation = MeasurementSimulation(scenario, seed, pair=pair, birds=BIRDS.get(scenario_name, 0))
    filter_, comparison, used = MultiBernoulliFilter(settings, motion), TrackComparison(), 0.0
    for scan in simulation.scans():
        begun = wall.process_time()
        motion.add(Pose.level(scan.time, 0.0))
        if scan.doas:
            filter_.update_sound(scan.time, scan.doas)
        filter_.update_image(scan.time, scan.image)
        found = {}
        for track in filter_.tracks:
            primary = track.mixture.primary()
            if track.existence >= settings.confirmed and primary is not None and not track.kind.drone < 0.5:
                found[track.id] = np.array(direction(primary.azimuth, primary.elevation))
        used += wall.process_time() - begun
        comparison.add(scan.truth, found)
    return (*comparison.figures(), 100.0 * used / scan.time)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table of means over the seeds."""
    parser = argparse.ArgumentParser(prog='multi_target', description=__doc__)
    parser.add_argument('scenarios', nargs='*', default=list(SCENARIOS), help=f'by default {" ".join(SCENARIOS)}')
    parser.add_argument('--seeds', type=number, default=5, help='runs of each scenario (%(default)s)')
    parser.add_argument('--seed', type=whole, default=1, help='of the first run (%(default)s)')
    parser.add_argument('--pair', action='store_true', help='two microphones, which measure cones, in place of four')
    parser.add_argument('--alike', action='store_true', help='all targets are of the same type')
    return run_program(_compare, parser, arguments)


def _compare(options: argparse.Namespace) -> int:
    for scenario in options.scenarios:
        load_scenario(find_config(scenario, 'scenarios'))    # one that cannot be used is named before the others are computed
    print(f'{"":<18}{"GOSPA":>8}{"error":>9}{"missed":>8}{"false":>7}{"switches":>10}{"names kept":>12}'
          f'{"of a core":>11}')
    with processes() as pool:
        for scenario in options.scenarios:
            runs = pool.map(partial(run, scenario, options.pair, options.alike),
                            range(options.seed, options.seed + options.seeds))
            mean, error, missed, false, switches, kept, percent = np.mean(list(runs), axis=0)
            print(f'{scenario:<18}{mean:>6.2f} °{error:>7.2f} °{missed:>8.2f}{false:>7.2f}{switches:>10.1f}'
                  f'{100.0 * kept:>10.0f} %{percent:>9.1f} %', flush=True)
    return 0
