"""How soon, and how surely, front is told from back: random starts with the drone behind, in fog, heard by the real localizer.

Each start is flown in the simulator (sound field, ground, noise at a set ratio) with a rig that obeys the pointing
controller; methods differ in tracker and in the turn they ask for. A decision counts from the first sample of sound on. It is
wrong when the bearing belongs to the mirror image, or is off by more than 20 degrees. Images closer together than 10 degrees,
at end-fire, are one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from av_common.angles import wrap
from av_common.rig import load_rig
from av_evaluation.experiments.offline_run import OfflineRun
from av_fusion.baseline.gated_tracker import GatedSettings, GatedTracker
from av_fusion.disambiguation.rotation import RotationSettings
from av_fusion.filter.settings import BayesSettings
from av_fusion.filter.tracker import BayesTracker
from av_pointing.controller import PointingController, PointingSettings
from av_simulator.config_files import find_config
from av_simulator.profile import Profile
from av_simulator.scenario import Scenario, Target, Weather
from av_simulator.sound import Ground
from av_simulator.sound.noise import Noise, Snr
from av_simulator.trajectories import Circle

LISTEN_S = 10.0  # after which a start counts as undecided
WRONG_BY = math.radians(20.0)
SAME = math.radians(10.0)  # closer together than this, the images are one
FIXED = math.radians(45.0)
METHODS = {
    'planned': 'the filter, with the turn that it expects to tell most',
    'fixed': "the filter's decision, with the paper's turn of 45 degrees",
    'published': "the paper's turn of 45 degrees, and its decision after it",
}


@dataclass(frozen=True)
class Start:
    """Where the drone begins, in the rig's frame, how fast it goes round, how loud it is over the noise, and its kind."""

    azimuth_deg: float
    rate_deg: float
    snr_db: float
    drone: str
    seed: int


@dataclass(frozen=True)
class Decision:
    """When front and back were declared (s from the first sample; inf: not within LISTEN_S), and whether wrongly so."""

    time: float
    wrong: bool
    probability: float


def draw_starts(count: int, seed: int = 1, fastest_deg: float = 20.0) -> list[Start]:
    """Starts behind the rig: azimuth 90..270 deg, rate up to +-`fastest_deg` deg/s and 0..20 dB, all uniform."""
    random = np.random.default_rng(seed)
    drones = sorted(file.stem for file in find_config('camera_quadrotor', 'drones').parent.glob('*.yaml'))
    return [Start(float(random.uniform(90.0, 270.0)), float(random.uniform(-fastest_deg, fastest_deg)),
                  float(random.uniform(0.0, 20.0)), str(random.choice(drones)), 1000 * seed + k) for k in range(count)]


def scenario_of(start: Start) -> Scenario:
    """The drone circles at 10 m in fog that hides it, over ground that reflects."""
    path = Circle(center=(0.0, 0.0, 3.0), radius=10.0, period=360.0 / (start.rate_deg or 1e-3), start_deg=start.azimuth_deg)
    return Scenario('front_back', (Target(path, drone=start.drone),), LISTEN_S, start.seed,
                    weather=Weather(fog=Profile(values=(0.8,))), ground=Ground('forest'),
                    noise=Noise(diffuse_db_spl=30.0, snr=Snr(start.snr_db, 10.0)))


def tracker_of(method: str) -> BayesTracker | GatedTracker:
    """The tracker of one of METHODS."""
    if method == 'published':
        return GatedTracker(GatedSettings())
    turn = RotationSettings() if method == 'planned' else replace(RotationSettings(), fixed=FIXED)
    return BayesTracker(BayesSettings(rotation=turn))


def decide(start: Start, method: str) -> Decision:
    """Fly one start until front and back are declared."""
    run = OfflineRun(scenario_of(start), load_rig(find_config('rig')), tracker_of(method), start.seed,
                     PointingController(PointingSettings(move_gimbal=False)))
    for now, bearing in run.steps():
        if bearing is not None and bearing.resolved:
            truth = float(run.log.true_azimuth([now])[0])
            return Decision(now, is_wrong(bearing.azimuth, truth), bearing.hemisphere_probability)
    return Decision(math.inf, False, 0.5)


def is_wrong(azimuth: float, truth: float) -> bool:
    """Whether a bearing belongs to the mirror image (rad, in the rig's frame), or to neither."""
    off, mirrored = abs(wrap(azimuth - truth)), abs(wrap(azimuth - (math.pi - truth)))
    return bool(off > WRONG_BY or (off > mirrored and off > SAME))


def summarise(decisions: Sequence[Decision]) -> dict[str, float]:
    """Share wrong and undecided, and seconds to decide: median, 95th percentile, longest (undecided ones are infinite)."""
    times = np.sort([decision.time for decision in decisions])
    return {'starts': len(times), 'wrong': float(np.mean([decision.wrong for decision in decisions])),
            'undecided': float(np.mean(np.isinf(times))),
            **{name: float(times[min(math.ceil(share * len(times)), len(times)) - 1])
               for name, share in (('median', 0.5), ('p95', 0.95), ('longest', 1.0))}}
