"""Time and reliability of resolving front and back: random starts with the drone behind the rig, in fog, without detections.

With `seen` the fog is so thin that a camera sees the drone where it looks there; a start then ends when the drone is seen, too.

Each start is simulated (sound field, ground, noise at a given ratio) with a rig that obeys the pointing controller and with the
shipped localizer. Methods differ in tracker and requested rotation. Times count from the first sample. A resolution is wrong
when the bearing is nearer to the mirrored direction, or has an error of more than 20 degrees. Hypotheses closer together than
10 degrees, at end-fire, count as one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from av_common.angles import wrap
from av_common.rig import GimbalMount, load_rig
from av_evaluation.experiments.offline_run import OfflineRun
from av_fusion.disambiguation.rotation import RotationSettings
from av_fusion.gated.tracker import GatedTracker
from av_fusion.tracker import MultiTargetTracker, TrackerSettings
from av_interfaces.msg import Bearing
from av_pointing.controller import PointingController, PointingSettings
from av_pointing.settings import with_gimbal
from av_simulator.config_files import find_config
from av_simulator.profile import Profile
from av_simulator.scenario import Scenario, Target, Weather
from av_simulator.sound import Ground
from av_simulator.sound.noise import Noise, Snr
from av_simulator.trajectories import Circle

DURATION_S = 10.0  # after which a start counts as unresolved
WRONG_BY = math.radians(20.0)
SAME = math.radians(10.0)  # hypotheses closer together count as one
FIXED = math.radians(45.0)
METHODS = {
    'planned': 'the filter, with the rotation of the largest expected information',
    'fixed': "the filter, with the publication's rotation of 45 degrees",
    'published': 'the published controller, with its rotation of 45 degrees',
    'gimbal': 'as planned, with the camera on a gimbal (config/rig_gimbal.yaml)',
}
DENSE, THIN = 0.8, 0.12  # 1/m, fog that hides a drone at 10 m, and fog that does not: the transmission is 30 %


@dataclass(frozen=True)
class Start:
    """Initial state of a run.

    Parameters:
        azimuth_deg (degrees): of the drone, in the body frame.
        rate_deg (degrees/s): at which it circles.
        snr_db (dB): signal-to-noise ratio at 10 m.
        drone: file of its sound.
        seed: of the noise.
    """

    azimuth_deg: float
    rate_deg: float
    snr_db: float
    drone: str
    seed: int


@dataclass(frozen=True)
class Resolution:
    """Result of a start.

    Parameters:
        time (s): from the first sample to the first resolved bearing; inf where there is none within DURATION_S.
        wrong: whether that bearing is wrong.
        probability: of the hemisphere, by the tracker.
    """

    time: float
    wrong: bool
    probability: float


def draw_starts(count: int, seed: int = 1, fastest_deg: float = 20.0) -> list[Start]:
    """Random starts behind the rig: azimuth 90 to 270 degrees, ratio 0 to 20 dB, rate in both directions, all uniform.

    Parameters:
        count: of starts.
        seed: of the random draws.
        fastest_deg (degrees/s): largest rate.
    """
    random = np.random.default_rng(seed)
    drones = sorted(file.stem for file in find_config('camera_quadrotor', 'drones').parent.glob('*.yaml'))
    return [Start(float(random.uniform(90.0, 270.0)), float(random.uniform(-fastest_deg, fastest_deg)),
                  float(random.uniform(0.0, 20.0)), str(random.choice(drones)), 1000 * seed + k) for k in range(count)]


def scenario_of(start: Start, fog: float = DENSE) -> Scenario:
    """The scenario of a start: the drone circles at 10 m in fog (1/m), over reflecting ground."""
    path = Circle(center=(0.0, 0.0, 3.0), radius=10.0, period=360.0 / (start.rate_deg or 1e-3), start_deg=start.azimuth_deg)
    return Scenario('front_back', (Target(path, drone=start.drone),), DURATION_S, start.seed,
                    weather=Weather(fog=Profile(values=(fog,))), ground=Ground('forest'),
                    noise=Noise(diffuse_db_spl=30.0, snr=Snr(start.snr_db, 10.0)))


def tracker_of(method: str, gimbal: GimbalMount | None = None) -> MultiTargetTracker | GatedTracker:
    """The tracker of one of METHODS, on a rig with a gimbal or without one."""
    if method == 'published':
        return GatedTracker()
    rotation = replace(RotationSettings(), fixed=FIXED) if method == 'fixed' else RotationSettings()
    return MultiTargetTracker(TrackerSettings(rotation=rotation, gimbal=gimbal))


def resolve(start: Start, method: str, seen: bool = False) -> Resolution:
    """Simulate one start until front and back are resolved.

    Parameters:
        start: the start.
        method: one of METHODS.
        seen: whether the drone must have been seen, too, in thin fog.
    """
    rig = load_rig(find_config('rig_gimbal' if method == 'gimbal' else 'rig'))
    pointing = PointingController(with_gimbal(PointingSettings(move_gimbal=rig.gimbal is not None), rig.gimbal))
    run = OfflineRun(scenario_of(start, THIN if seen else DENSE), rig, tracker_of(method, rig.gimbal), start.seed, pointing)
    for now, bearing in run.steps():
        if bearing is not None and bearing.resolved and (not seen or bearing.source & Bearing.SOURCE_SIGHT):
            truth = float(run.log.true_azimuth([now])[0])
            return Resolution(now, is_wrong(bearing.azimuth, truth), bearing.hemisphere_probability)
    return Resolution(math.inf, False, 0.5)


def is_wrong(azimuth: float, truth: float) -> bool:
    """Whether a resolved bearing is wrong.

    Parameters:
        azimuth (rad): of the bearing, in the body frame.
        truth (rad): true azimuth.
    """
    error, mirrored = abs(wrap(azimuth - truth)), abs(wrap(azimuth - (math.pi - truth)))
    return bool(error > WRONG_BY or (error > mirrored and error > SAME))


def summarise(resolutions: Sequence[Resolution]) -> dict[str, float]:
    """Shares wrong and unresolved, and time to resolve (s): median, 95th percentile, longest; inf for unresolved starts."""
    times = np.sort([resolution.time for resolution in resolutions])
    return {'starts': len(times), 'wrong': float(np.mean([resolution.wrong for resolution in resolutions])),
            'unresolved': float(np.mean(np.isinf(times))),
            **{name: float(times[min(math.ceil(share * len(times)), len(times)) - 1])
               for name, share in (('median', 0.5), ('p95', 0.95), ('longest', 1.0))}}
