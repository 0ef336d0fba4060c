"""How well the bearing of fusion is what it says, by scenarios of the formula rig: logarithms of its density at the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from formula_rig import FormulaRig, Moment, Source, azimuth_of, never, unit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scoring import SOMEWHERE, score_of

from av_interfaces.msg import Bearing

BEGIN_S, EVERY_S = 1.0, 0.25  # of the outputs that count
FALSE = math.log(0.05)  # score of following what is no target
LOOK_RATE = math.radians(40.0)  # rad/s, of a rig that turns as it is asked to

def scenarios(seed: int) -> dict[str, tuple[FormulaRig, float]]:
    """Rigs and the time (s) for which they run, by name of the scenario.

    Parameters:
        seed: of the measurements and places.
    """
    rng = np.random.default_rng([77, seed])
    anywhere, behind = float(rng.uniform(-180.0, 180.0)), float(rng.uniform(100.0, 260.0))
    heard = rng.random(200) < 0.35
    drone, other = (lambda t: 0.8 + 0.15 * math.sin(37.0 * t + seed)), (lambda t: 0.17 + 0.15 * math.sin(37.0 * t + seed))
    bystander = Source.at(-50.0, 2.0, drone_probability=other, seen=never)
    deaf: dict[str, Any] = {'sight': never}
    made: dict[str, tuple[dict[str, Any], list[Source], float]] = {
        'sound and sight, circle': ({}, [Source.at(-30.0, 6.0, 8.0, drone_probability=drone)], 8.0),
        'sound and sight, to and fro': ({'sight_clutter': 0.2, 'visibility': lambda t: 0.8}, [Source(_weaving)], 8.0),
        'sight with clutter': ({'sound': never, 'sight_clutter': 0.5, 'detection_probability': 0.6},
                               [Source.at(10.0, 5.0, 2.0)], 8.0),
        'sight, low scores': ({'sound': never, 'detection_probability': 0.6}, [Source.at(12.0, 5.0, 3.0, score=0.4)], 8.0),
        'pair that turns by 40 deg': (deaf | {'sound_clutter': 0.3, 'attitude': _turning(40.0, 2.0, 40.0)},
                                      [Source.at(anywhere, 4.0, 4.0, drone_probability=drone)], 7.0),
        'pair that turns as asked': (deaf, [Source.at(anywhere, 5.0)], 7.0),
        'pair with a camera that turns as asked': ({'visibility': lambda t: 0.9}, [Source.at(behind, 5.0)], 7.0),
        'square that turns at 80 deg/s': (deaf | {'array': 'square', 'sound_clutter': 0.3, 'attitude': _turning(80.0)},
                                          [Source.at(40.0, 10.0, confidence=0.5)], 6.0),
        'eight with clutter': (deaf | {'array': 'eight', 'sound_clutter': 0.5},
                               [Source.at(-60.0, 20.0, 6.0, confidence=0.6)], 6.0),
        'eight that sway': (deaf | {'array': 'eight', 'attitude': _swaying}, [Source.at(20.0, 5.0, 10.0)], 6.0),
        'square, faint': (deaf | {'array': 'square', 'sound_clutter': 0.3},
                          [Source.at(35.0, 8.0, 4.0, heard=lambda t: bool(heard[int(10.0 * t)]), confidence=0.5)], 8.0),
        'square, drone and bystander': (deaf | {'array': 'square'},
                                        [Source.at(30.0, 5.0, 3.0, drone_probability=drone), bystander], 8.0),
        'square, bystander alone': (deaf | {'array': 'square'}, [bystander], 8.0),
        'clutter alone': ({'sound_clutter': 0.4, 'sight_clutter': 0.2}, [Source.at(0.0, heard=never, seen=never)], 6.0),
        'two that cross': ({}, [Source.at(-20.0, 6.0, 6.0), Source.at(20.0, 9.0, -6.0)], 8.0),
        'steps of 20 deg': ({}, [Source(lambda t: unit(-10.0 + 20.0 * (int(t / 3.0) % 3), 5.0))], 9.0),
        'hidden now and then': ({'visibility': lambda t: 0.9, 'lasting': 0.03},
                                [Source.at(15.0, 5.0, 2.0, seen=lambda t: t % 5.0 < 2.5)], 9.0),
        'out of view and behind': ({'visibility': lambda t: 0.9}, [Source.at(60.0, 6.0, 15.0)], 9.0),
        'fog': ({'visibility': lambda t: 0.2}, [Source.at(-10.0, 5.0, 4.0)], 8.0),
        'end-fire': ({}, [Source(lambda t: unit(90.0 + 24.0 * math.sin(1.1 * t + 0.5), 9.0), confidence=0.45)], 8.0),
        'a pass at 8 m': ({}, [Source(_passing)], 6.0),
        'an echo': ({'lasting': 0.02},
                    [Source.at(30.0, 5.0, 2.0), Source.at(-70.0, 5.0, -1.0, confidence=0.6, seen=never)], 8.0),
    }
    return {name: (FormulaRig(sources, seed=seed, **options), seconds) for name, (options, sources, seconds) in made.items()}


def _turning(rate_deg: float, begin: float = 0.0, most_deg: float = math.inf) -> Callable[[float], Rotation]:
    """A rig that turns evenly from `begin` (s) on, by an angle at most."""
    return lambda t: Rotation.from_euler('z', min(max(t - begin, 0.0) * rate_deg, most_deg), degrees=True)


def _swaying(t: float) -> Rotation:
    return Rotation.from_euler('ZYX', [10.0 * t, 25.0 * math.sin(1.9 * t), 25.0 * math.sin(2.4 * t + 1.0)], degrees=True)


def _weaving(t: float) -> NDArray:
    return unit(25.0 * math.sin(0.9 * t), 8.0 + 4.0 * math.sin(1.3 * t))


def _passing(t: float) -> NDArray:
    place = np.array([8.0, 8.0 * t - 20.0, 4.0])
    return place / np.linalg.norm(place)


def scores(runs: int) -> dict[str, list[float]]:
    """The mean score of each run of each scenario: see `score_of`, of the bearings.

    Parameters:
        runs: of each scenario, with other measurements.
    """
    found: dict[str, list[float]] = {}
    for seed in range(runs):
        for name, (rig, seconds) in scenarios(seed).items():
            if 'as asked' in name:
                _obey(rig, seconds)
            else:
                rig.run(seconds)
            found.setdefault(name, []).append(_score(rig, name))
    return found


def _obey(rig: FormulaRig, seconds: float) -> None:
    """Run a rig that makes the rotations that are requested."""
    yaws, step = [0.0], 0.02 * LOOK_RATE
    rig.attitude = lambda t: Rotation.from_euler('z', np.interp(t, 0.02 * np.arange(len(yaws)), yaws))
    for _ in rig.steps(seconds):
        bearing = rig.moments[-1].bearing if rig.moments else Bearing()
        asked = bearing.requested_rotation if bearing.state != Bearing.STATE_NONE and not bearing.resolved else 0.0
        yaws.append(yaws[-1] + min(max(asked, -step), step))


def _score(rig: FormulaRig, name: str) -> float:
    """Mean over outputs; of several targets the one that is followed counts."""
    alone, both = name.endswith('alone'), name == 'two that cross'
    sources = range(len(rig.sources) if both else 1)
    due, values = BEGIN_S, []
    for moment in rig.moments:
        if moment.t >= due:
            due += EVERY_S
            follows = moment.bearing.state != Bearing.STATE_NONE
            if alone:
                values.append(FALSE if follows else 0.0)
            elif follows:
                values.append(max(_score_at(moment, rig.body(moment.t, k)) for k in sources))
            else:
                values.append(score_of(SOMEWHERE))
    return float(np.mean(values))


def _score_at(moment: Moment, truth: NDArray) -> float:
    """Score of a bearing at a direction (3,) in the body: a Gaussian on either side of the axis to the left."""
    bearing, azimuth = moment.bearing, math.radians(azimuth_of(truth))
    density = 0.0
    for share, place in ((bearing.hemisphere_probability, bearing.azimuth),
                         (1.0 - bearing.hemisphere_probability, math.pi - bearing.azimuth)):
        error = math.remainder(place - azimuth, math.tau)
        variance = bearing.azimuth_variance
        density += share * math.exp(-0.5 * error**2 / variance) / math.sqrt(math.tau * variance)
    return score_of(density)
