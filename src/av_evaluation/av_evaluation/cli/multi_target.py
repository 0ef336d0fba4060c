"""ros2 run av_evaluation multi_target SCENARIO...: targets on simulated measurements, beside JPDA of Stone Soup."""

from __future__ import annotations

import argparse
import math
import os
import sys
import time as wall
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from av_evaluation.experiments.measurement_simulation import MeasurementSimulation, Scan, SensorModel
from av_evaluation.metrics.tracks import TrackComparison, TrackFigures
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.measurement.vectors import direction
from av_fusion.tracks.filter import MultiBernoulliFilter
from av_fusion.tracks.settings import FilterSettings
from av_simulator.config_files import find_config
from av_simulator.scenario import load_scenario

SCENARIOS = ('crossing', 'swarm_5', 'birds_and_drones', 'swarm_10')
OWN, JPDA = 'av_fusion', 'Stone Soup JPDA'
BETTER = 0.25  # share by which the mean GOSPA is to be below that of the peer
BIRDS = {'birds_and_drones': 6}


class Peer(Protocol):
    """A multi-target tracker."""

    def use(self, scan: Scan) -> dict[int, NDArray[np.float64]]:
        """Use a scan; unit vectors (3,) to the targets in the body's frame, by the name of each."""

    def identity(self) -> float:
        """Least probability that a track still follows the target that was given its name; NaN where it is not known."""


class OwnFilter:
    """The rig's filter as a `Peer`, for a rig that stands still.

    Attributes:
        filter: the filter.

    Parameters:
        settings: see `FilterSettings`.
    """

    def __init__(self, settings: FilterSettings | None = None) -> None:
        self._settings = settings or FilterSettings()
        self._motion = RigMotion()
        self.filter = MultiBernoulliFilter(self._settings, self._motion)

    def use(self, scan: Scan) -> dict[int, NDArray[np.float64]]:
        """See `Peer`."""
        self._motion.add(Pose.level(scan.time, 0.0))
        if scan.doas is not None:
            self.filter.update_sound(scan.time, scan.doas)
        if scan.image is not None:
            self.filter.update_image(scan.time, scan.image)
        found = {}
        for track in self.filter.tracks:
            primary = track.mixture.primary()
            if track.existence >= self._settings.confirmed and primary is not None and not track.kind.drone < 0.5:
                found[track.id] = np.array(direction(primary.azimuth, primary.elevation))
        return found

    def identity(self) -> float:
        """See `Peer`."""
        return min((track.identity for track in self.filter.tracks if track.existence >= self._settings.confirmed),
                   default=math.nan)


@dataclass(frozen=True)
class MultiTargetFigures:
    """Figures of one tracker in one run.

    Parameters:
        tracks: see `TrackFigures`.
        identity: see `Peer`, at last.
        percent: processor time over the duration of the run, in percent.
    """

    tracks: TrackFigures
    identity: float
    percent: float


def figures_of(peer: Peer, scans: Iterable[Scan]) -> MultiTargetFigures:
    """Run a tracker on the scans of a run.

    Parameters:
        peer: the tracker.
        scans: measurements and truth.
    """
    comparison, used, last = TrackComparison(), 0.0, 0.0
    for scan in scans:
        begun = wall.process_time()
        tracks = peer.use(scan)
        used, last = used + wall.process_time() - begun, scan.time
        comparison.add(scan.truth, tracks)
    return MultiTargetFigures(comparison.figures(), peer.identity(), 100.0 * used / max(last, 1e-9))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; returns 1 where the filter is not BETTER than a peer."""
    options = _parser().parse_args(arguments)
    names = [OWN, JPDA] if find_spec('stonesoup') and not options.without_peers else [OWN]
    if len(names) == 1 and not options.without_peers:
        print('stonesoup is not installed: without its tracker (pip install stonesoup)', file=sys.stderr)
    seeds = range(options.seed, options.seed + options.seeds)
    jobs = [Job(scenario, seed, name, options.pair, options.alike, options.rate)
            for scenario in options.scenarios for seed in seeds for name in names]
    with ProcessPoolExecutor(options.workers or os.cpu_count()) as pool:
        found = dict(zip(jobs, pool.map(run, jobs), strict=True))
    print(f'{"":<18}{"":<19}{"GOSPA":>8}{"error":>9}{"missed":>8}{"false":>7}{"switches":>10}{"names kept":>12}{"identity":>10}'
          f'{"of a core":>11}')
    worse = []
    for scenario in options.scenarios:
        means = {}
        for name in names:
            runs = [found[Job(scenario, seed, name, options.pair, options.alike, options.rate)] for seed in seeds]
            means[name] = _print(scenario, name, runs)
        worse += [f'{scenario}: {means[OWN]:.2f} deg, {name} {mean:.2f} deg' for name, mean in means.items()
                  if name != OWN and means[OWN] > (1.0 - BETTER) * mean]
    for line in worse:
        print(f'MISSED: GOSPA of {line}, expected {100 * BETTER:.0f} % less')
    return 1 if worse else 0


class Job(NamedTuple):
    """One tracker in one run.

    Parameters:
        scenario: its name or file.
        seed: of the measurements.
        tracker: its name.
        pair: whether the microphones are a pair.
        alike: whether all targets are of the type of the first.
        rate (Hz): of windows and of images.
    """

    scenario: str
    seed: int
    tracker: str
    pair: bool = False
    alike: bool = False
    rate: float = 10.0


def run(job: Job) -> MultiTargetFigures:
    """Figures of one tracker in one run."""
    model = SensorModel(pair=job.pair, sound_rate=job.rate, image_rate=job.rate, birds=BIRDS.get(job.scenario, 0))
    scenario = load_scenario(find_config(job.scenario, 'scenarios'))
    if job.alike:
        first = scenario.targets[0]
        scenario = replace(scenario, targets=tuple(replace(target, drone=first.drone, signal=first.signal)
                                                   for target in scenario.targets))
    simulation = MeasurementSimulation(scenario, job.seed, model)
    return figures_of(_make(job.tracker, model), simulation.scans())


def _make(name: str, model: SensorModel) -> Peer:
    if name == OWN:
        return OwnFilter()
    from av_evaluation.experiments.stone_soup import StoneSoupJpda  # an optional dependency

    return StoneSoupJpda(model)


def _print(scenario: str, name: str, runs: Sequence[MultiTargetFigures]) -> float:
    """Print the means of the runs; returns that of GOSPA (deg)."""
    table = np.array([(*each.tracks, each.identity, each.percent) for each in runs])
    mean, error, missed, false, switches, kept, identity, percent = table.mean(axis=0).tolist()
    print(f'{scenario:<18}{name:<19}{mean:>6.2f} °{error:>7.2f} °{missed:>8.2f}{false:>7.2f}{switches:>10.1f}'
          f'{100.0 * kept:>10.0f} %{identity:>10.2f}{percent:>9.1f} %', flush=True)
    return float(mean)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='multi_target', description=__doc__)
    parser.add_argument('scenarios', nargs='*', default=list(SCENARIOS), help=f'by default {" ".join(SCENARIOS)}')
    parser.add_argument('--seeds', type=int, default=5, help='runs of each scenario (%(default)s)')
    parser.add_argument('--seed', type=int, default=1, help='of the first run (%(default)s)')
    parser.add_argument('--pair', action='store_true', help='two microphones, which measure cones, in place of four')
    parser.add_argument('--alike', action='store_true', help='all targets are of the same type')
    parser.add_argument('--rate', type=float, default=10.0, help='of windows and of images in Hz (%(default)s)')
    parser.add_argument('--without-peers', action='store_true', help='this filter alone')
    parser.add_argument('--workers', type=int, default=0, help='parallel processes; 0: one for each core')
    return parser
