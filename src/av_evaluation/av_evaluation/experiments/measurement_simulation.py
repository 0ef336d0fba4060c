"""A scenario as measurements, without rendering sound or images: hundreds of runs in the time of one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_fusion.measurement.measurements import CameraMeasurement, Cone, Detection, DoaMeasurement, Hypothesis
from av_simulator.config_files import find_config
from av_simulator.scenario import Scenario, Target, value_at
from av_simulator.sound.rotor import RotorSignal
from av_simulator.sound.source import load_profile
from av_simulator.trajectories import RandomFlight, Trajectory

LEFT = (0.0, 1.0, 0.0)  # axis of a pair
# What microphones and camera report of targets: as the rig's stages of rendered scenarios, rounded.
RATE_HZ = 10.0  # of windows and images
WINDOW_S = 0.5  # errors of windows that overlap are correlated
SOUND_SIGMA, ELEVATION_SIGMA = math.radians(1.5), math.radians(4.0)  # of directions at end-fire's normal, without noise
MOST_SOURCES = 4  # directions in one window
DYNAMIC_DB = 12.0  # level below that of the loudest source from which a source is not found
FLUCTUATION_DB, FLUCTUATION_S = 3.0, 0.5  # standard deviation and correlation time of each source's level
RESOLUTION = math.radians(10.0)  # sources closer than this to a louder one are not found
NEAREST_M = 1e-3  # of a target: one at the rig's own place has no direction
NOISE_M = 60.0  # distance at which a source is as loud as the noise
HALF_VIEW, HALF_HEIGHT = math.radians(35.0), math.radians(27.0)  # half of the camera's field of view
SIGHT_SIGMA = math.radians(0.3)  # of detections
DETECTED = 0.9  # probability, of a target in view, in clear air
SEPARATION = math.radians(1.5)  # of two targets from which both are detected
FUNDAMENTAL_SIGMA = 0.03  # relative error of the blade-pass frequency of what is heard
FUNDAMENTAL_WRONG = 0.1  # share of fundamentals that are twice or half of the true one, or anything


class Scan(NamedTuple):
    """The measurements of one instant, and the truth.

    Parameters:
        time (s): capture time.
        doas: directions of arrival.
        image: detections.
        truth (n, 3): unit vectors to the targets in the body's frame.
    """

    time: float
    doas: tuple[DoaMeasurement, ...]
    image: CameraMeasurement
    truth: NDArray[np.float64]


class MeasurementSimulation:
    """Draws the measurements of a scenario for a level rig.

    Parameters:
        scenario: targets and air.
        seed: of all draws.
        turn: from time (s) to what the rig's yaw (rad) is beyond its initial one.
        pair: whether the microphones are a pair on the y axis, which measures cones; else four that lie in no plane.
        birds: number of birds that fly around the rig: silent, and detected with lower scores than drones.
        sound_clutter, sight_clutter: expected numbers of false directions in a window and of false detections in an image.
    """

    def __init__(self, scenario: Scenario, seed: int, turn: Callable[[float], float] = lambda time: 0.0, *, pair: bool = False,
                 birds: int = 0, sound_clutter: float = 0.2, sight_clutter: float = 0.05) -> None:
        self._scenario, self._turn, self._pair = scenario, turn, pair
        self._sound_clutter, self._sight_clutter = sound_clutter, sight_clutter
        self._random = np.random.default_rng(seed)
        self._targets, count = [target.trajectory for target in scenario.targets], len(scenario.targets)
        self._birds = [RandomFlight((0.0, 0.0, 8.0), (18.0, 18.0, 3.0), 14.0, 1000 * seed + bird) for bird in range(birds)]
        self._level = self._random.normal(0.0, FLUCTUATION_DB, count)  # dB
        self._overlap = round(WINDOW_S * RATE_HZ)  # windows that share noise with one
        self._noise = self._random.normal(size=(self._overlap, count, 2))  # of the parts of the newest window
        self._blade_pass = [blade_pass_of(target) for target in scenario.targets]
        self._voices = np.random.default_rng([seed, 1])  # of fundamentals, so that directions do not depend on them

    def scans(self) -> Iterator[Scan]:
        """All scans of the scenario in order."""
        for time in np.arange(0.0, self._scenario.duration, 1.0 / RATE_HZ).tolist():
            vectors, distances = self._seen_from_rig(time, self._targets)
            yield Scan(time, self._hear(time, vectors, distances), self._see(time), vectors)

    def truth(self, time: float) -> NDArray[np.float64]:
        """Unit vectors (n, 3) to the targets in the body's frame at a time (s)."""
        return self._seen_from_rig(time, self._targets)[0]

    def yaw(self, time: float) -> float:
        """The rig's yaw (rad) at a time (s)."""
        return math.radians(self._scenario.rig.yaw_deg) + self._turn(time)

    def _seen_from_rig(self, time: float, trajectories: Sequence[Trajectory]
                       ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Unit vectors (n, 3) in the body's frame and distances (n,) in m."""
        rig = self._scenario.rig
        offsets = np.array([trajectory(time)[0] for trajectory in trajectories]) - rig.trajectory(time)[0]
        yaw = self.yaw(time)
        turn = np.array([[math.cos(yaw), math.sin(yaw), 0.0], [-math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        distances = np.maximum(np.linalg.norm(offsets, axis=1), NEAREST_M)
        return offsets @ turn.T / distances[:, np.newaxis], distances

    def _hear(self, time: float, vectors: NDArray[np.float64], distances: NDArray[np.float64]) -> tuple[DoaMeasurement, ...]:
        kept = math.exp(-1.0 / (RATE_HZ * FLUCTUATION_S))
        change = self._random.normal(0.0, FLUCTUATION_DB, len(distances))
        self._level = kept * self._level + math.sqrt(1.0 - kept**2) * change
        self._noise = np.concatenate([self._noise[1:], self._random.normal(size=(1, *self._noise.shape[1:]))])
        errors = self._noise.sum(axis=0) / math.sqrt(self._overlap)
        gains = np.array([target.gain_db for target in self._scenario.targets])
        levels = gains + self._level - 20.0 * np.log10(distances / NOISE_M)
        found: list[int] = []
        for source in np.argsort(-levels)[:len(levels)]:
            clear = all(vectors[source] @ vectors[other] < math.cos(RESOLUTION) for other in found)
            if clear and levels[source] > max(0.0, levels.max() - DYNAMIC_DB) and len(found) < MOST_SOURCES:
                found.append(int(source))
        heard = [self._direction(time, vectors[k], float(levels[k]), errors[k], self._blade_pass[k]) for k in found]
        for _ in range(self._random.poisson(self._sound_clutter)):
            azimuth, elevation = self._random.uniform(-math.pi, math.pi), self._random.normal(0.15, 0.15)
            false = np.array([math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation),
                              math.sin(elevation)])
            heard.append(self._direction(time, false, self._random.uniform(0.0, 4.0), self._random.normal(size=2), math.nan))
        return tuple(sorted(heard, key=lambda doa: -doa.confidence)[:MOST_SOURCES])

    def _direction(self, time: float, vector: NDArray[np.float64], level: float, error: NDArray[np.float64], blade_pass: float
                   ) -> DoaMeasurement:
        """The measurement of a source `level` dB above the noise; `error` (2,) in standard deviations."""
        signal = 10.0 ** (0.1 * level)
        confidence = min(signal / (1.0 + signal), 0.98)
        sigma = SOUND_SIGMA * math.sqrt(1.0 + 4.0 / signal)
        if self._pair:
            slope = max(math.sqrt(1.0 - vector[1] ** 2), 0.1)
            cosine = float(np.clip(vector[1] + slope * sigma * error[0], -1.0, 1.0))
            measured = DoaMeasurement.of_cone(time, Cone(LEFT, cosine, (slope * sigma) ** 2), confidence, WINDOW_S)
            return self._sounding(measured, blade_pass)
        rise = sigma / SOUND_SIGMA * ELEVATION_SIGMA
        azimuth = math.atan2(vector[1], vector[0]) + sigma * error[0]
        hypothesis = Hypothesis(math.remainder(azimuth, math.tau), sigma**2, math.asin(vector[2]) + rise * error[1], rise**2)
        return self._sounding(DoaMeasurement(time, (hypothesis,), confidence, WINDOW_S), blade_pass)

    def _sounding(self, measurement: DoaMeasurement, blade_pass: float) -> DoaMeasurement:
        """The measurement with its fundamental, that of a source of `blade_pass` (Hz), or any where that is NaN."""
        kind, error, anything = self._voices.random(), self._voices.normal(), 45.0 * 20.0 ** self._voices.random()
        factor = 2.0 if kind < 0.4 * FUNDAMENTAL_WRONG else 0.5 if kind < 0.8 * FUNDAMENTAL_WRONG else 1.0
        wrong = math.isnan(blade_pass) or 0.8 * FUNDAMENTAL_WRONG <= kind < FUNDAMENTAL_WRONG
        found = anything if wrong else factor * blade_pass * (1.0 + FUNDAMENTAL_SIGMA * error)
        return measurement._replace(fundamental=found, fundamental_variance=(FUNDAMENTAL_SIGMA * found) ** 2)

    def _see(self, time: float) -> CameraMeasurement:
        random = self._random
        vectors, distances = self._seen_from_rig(time, [*self._targets, *self._birds])
        fog = float(value_at(self._scenario.weather.fog, time))
        shown: list[int] = []
        found = []
        for k in np.argsort(distances):  # the nearest hides those behind it
            azimuth, elevation = math.atan2(vectors[k, 1], vectors[k, 0]), math.asin(vectors[k, 2])
            in_view = abs(azimuth) < HALF_VIEW and abs(elevation) < HALF_HEIGHT
            seen = random.random() < DETECTED * math.exp(-fog * distances[k])
            apart = all(vectors[k] @ vectors[other] < math.cos(SEPARATION) for other in shown)
            if in_view and seen and apart:
                shown.append(int(k))
                score = random.beta(8.0, 2.0) if k < len(self._targets) else random.beta(2.0, 3.0)
                found.append(self._detection(azimuth, elevation, score))
        for _ in range(random.poisson(self._sight_clutter)):
            found.append(self._detection(random.uniform(-HALF_VIEW, HALF_VIEW),
                                         random.uniform(-0.5 * HALF_HEIGHT, HALF_HEIGHT), random.beta(2.0, 5.0)))
        visibility = math.exp(-fog * float(distances.mean()))
        return CameraMeasurement(time, tuple(found), HALF_VIEW, HALF_HEIGHT, visibility)

    def _detection(self, azimuth: float, elevation: float, score: float) -> Detection:
        across, up = azimuth + SIGHT_SIGMA * self._random.normal(), elevation + SIGHT_SIGMA * self._random.normal()
        return Detection(across, SIGHT_SIGMA**2, score, up, SIGHT_SIGMA**2)


def blade_pass_of(target: Target) -> float:
    """Blade-pass frequency (Hz) of a target in level flight; NaN for one without rotors."""
    signal = target.signal or load_profile(find_config(target.drone, 'drones')).signal
    return signal.blades * float(np.mean(signal.rotor_hz)) if isinstance(signal, RotorSignal) else math.nan
