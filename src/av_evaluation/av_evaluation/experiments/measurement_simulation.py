"""A scenario as measurements, without rendering sound or images: hundreds of runs in the time of one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_fusion.measurement.measurements import CameraMeasurement, Cone, Detection, DoaMeasurement, Hypothesis
from av_simulator.config_files import find_config
from av_simulator.scenario import Scenario, Target
from av_simulator.sound.rotor import RotorSignal
from av_simulator.sound.source import load_profile
from av_simulator.trajectories import RandomFlight, Trajectory

LEFT = (0.0, 1.0, 0.0)  # axis of a pair


@dataclass(frozen=True)
class SensorModel:
    """What microphones and camera report of targets. The values are those of the rig's stages on rendered scenarios, rounded.

    Parameters:
        pair: whether the microphones are a pair on the y axis, which measures cones; else four that lie in no plane.
        sound_rate, image_rate (Hz): of windows and images.
        window (s): length of the windows; errors of windows that overlap are correlated.
        sound_sigma, elevation_sigma (rad): errors of directions at end-fire's normal, without noise.
        most_sources: directions in one window.
        dynamic_range (dB): level below that of the loudest source from which a source is not found.
        fluctuation (dB), fluctuation_time (s): standard deviation and correlation time of each source's level.
        resolution (rad): sources closer than this to a louder one are not found.
        noise_distance (m): distance at which a source is as loud as the noise.
        sound_clutter: expected number of false directions in a window.
        half_view, half_height (rad): half of the camera's field of view.
        sight_sigma (rad): error of detections.
        detection_probability: of a target in view, in clear air.
        separation (rad): of two targets from which both are detected.
        sight_clutter: expected number of false detections in an image.
        birds: number of birds that fly around the rig: silent, and detected with lower scores than drones.
        fundamental_sigma: relative error of the blade-pass frequency of what is heard; 0 where it is not measured.
        fundamental_wrong: share of fundamentals that are twice or half of the true one, or anything.
    """

    pair: bool = False
    sound_rate: float = 10.0
    image_rate: float = 10.0
    window: float = 0.5
    sound_sigma: float = math.radians(1.5)
    elevation_sigma: float = math.radians(4.0)
    most_sources: int = 4
    dynamic_range: float = 12.0
    fluctuation: float = 3.0
    fluctuation_time: float = 0.5
    resolution: float = math.radians(10.0)
    noise_distance: float = 60.0
    sound_clutter: float = 0.2
    half_view: float = math.radians(35.0)
    half_height: float = math.radians(27.0)
    sight_sigma: float = math.radians(0.3)
    detection_probability: float = 0.9
    separation: float = math.radians(1.5)
    sight_clutter: float = 0.05
    birds: int = 0
    fundamental_sigma: float = 0.03
    fundamental_wrong: float = 0.1


class Scan(NamedTuple):
    """The measurements of one instant, and the truth.

    Parameters:
        time (s): capture time.
        doas: directions of arrival, None where no window is due.
        image: detections, None where no image is due.
        truth (n, 3): unit vectors to the targets in the body's frame.
    """

    time: float
    doas: tuple[DoaMeasurement, ...] | None
    image: CameraMeasurement | None
    truth: NDArray[np.float64]


class MeasurementSimulation:
    """Draws the measurements of a scenario for a level rig.

    Parameters:
        scenario: targets and air.
        seed: of all draws.
        model: see `SensorModel`.
        turn: from time (s) to what the rig's yaw (rad) is beyond its initial one.
    """

    def __init__(self, scenario: Scenario, seed: int, model: SensorModel | None = None,
                 turn: Callable[[float], float] = lambda time: 0.0) -> None:
        self._scenario, self._model, self._turn = scenario, model or SensorModel(), turn
        self._random = np.random.default_rng(seed)
        count = len(scenario.targets)
        self._birds = [RandomFlight((0.0, 0.0, 8.0), (18.0, 18.0, 3.0), 14.0, 1000 * seed + bird)
                       for bird in range(self._model.birds)]
        self._level = self._random.normal(0.0, self._model.fluctuation, count)  # dB
        self._overlap = max(round(self._model.window * self._model.sound_rate), 1)  # windows that share noise with one
        self._noise = self._random.normal(size=(self._overlap, count, 2))  # of the parts of the newest window
        self._blade_pass = [blade_pass_of(target) for target in scenario.targets]
        self._voices = np.random.default_rng([seed, 1])  # of fundamentals, so that directions do not depend on them

    def scans(self) -> Iterator[Scan]:
        """All scans of the scenario in order."""
        model, rate = self._model, max(self._model.sound_rate, self._model.image_rate)
        next_sound = next_image = 0.0
        for time in np.arange(0.0, self._scenario.duration, 1.0 / rate):
            vectors, distances = self._seen_from_rig(float(time), [target.trajectory for target in self._scenario.targets])
            doas = image = None
            if time >= next_sound - 1e-6:
                next_sound += 1.0 / model.sound_rate
                doas = self._hear(float(time), vectors, distances)
            if time >= next_image - 1e-6:
                next_image += 1.0 / model.image_rate
                image = self._see(float(time))
            yield Scan(float(time), doas, image, vectors)

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
        distances = np.linalg.norm(offsets, axis=1)
        return offsets @ turn.T / distances[:, np.newaxis], distances

    def _hear(self, time: float, vectors: NDArray[np.float64], distances: NDArray[np.float64]) -> tuple[DoaMeasurement, ...]:
        model = self._model
        kept = math.exp(-1.0 / (model.sound_rate * model.fluctuation_time))
        change = self._random.normal(0.0, model.fluctuation, len(distances))
        self._level = kept * self._level + math.sqrt(1.0 - kept**2) * change
        self._noise = np.concatenate([self._noise[1:], self._random.normal(size=(1, *self._noise.shape[1:]))])
        errors = self._noise.sum(axis=0) / math.sqrt(self._overlap)
        gains = np.array([target.gain_db for target in self._scenario.targets])
        levels = gains + self._level - 20.0 * np.log10(distances / model.noise_distance)
        found: list[int] = []
        for source in np.argsort(-levels)[:len(levels)]:
            clear = all(vectors[source] @ vectors[other] < math.cos(model.resolution) for other in found)
            if clear and levels[source] > max(0.0, levels.max() - model.dynamic_range) and len(found) < model.most_sources:
                found.append(int(source))
        heard = [self._direction(time, vectors[k], float(levels[k]), errors[k], self._blade_pass[k]) for k in found]
        for _ in range(self._random.poisson(model.sound_clutter)):
            azimuth, elevation = self._random.uniform(-math.pi, math.pi), self._random.normal(0.15, 0.15)
            false = np.array([math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation),
                              math.sin(elevation)])
            heard.append(self._direction(time, false, self._random.uniform(0.0, 4.0), self._random.normal(size=2), math.nan))
        return tuple(sorted(heard, key=lambda doa: -doa.confidence)[:model.most_sources])

    def _direction(self, time: float, vector: NDArray[np.float64], level: float, error: NDArray[np.float64], blade_pass: float
                   ) -> DoaMeasurement:
        """The measurement of a source `level` dB above the noise; `error` (2,) in standard deviations."""
        model = self._model
        signal = 10.0 ** (0.1 * level)
        confidence = min(signal / (1.0 + signal), 0.98)
        sigma = model.sound_sigma * math.sqrt(1.0 + 4.0 / signal)
        if model.pair:
            slope = max(math.sqrt(1.0 - vector[1] ** 2), 0.1)
            cosine = float(np.clip(vector[1] + slope * sigma * error[0], -1.0, 1.0))
            measured = DoaMeasurement.of_cone(time, Cone(LEFT, cosine, (slope * sigma) ** 2), confidence, model.window)
            return self._sounding(measured, blade_pass)
        rise = sigma / model.sound_sigma * model.elevation_sigma
        azimuth = math.atan2(vector[1], vector[0]) + sigma * error[0]
        hypothesis = Hypothesis(math.remainder(azimuth, math.tau), sigma**2, math.asin(vector[2]) + rise * error[1], rise**2)
        return self._sounding(DoaMeasurement(time, (hypothesis,), confidence, model.window), blade_pass)

    def _sounding(self, measurement: DoaMeasurement, blade_pass: float) -> DoaMeasurement:
        """The measurement with its fundamental, that of a source of `blade_pass` (Hz), or any where that is NaN."""
        model = self._model
        if model.fundamental_sigma == 0.0:
            return measurement
        kind, error, anything = self._voices.random(), self._voices.normal(), 45.0 * 20.0 ** self._voices.random()
        factor = 2.0 if kind < 0.4 * model.fundamental_wrong else 0.5 if kind < 0.8 * model.fundamental_wrong else 1.0
        wrong = math.isnan(blade_pass) or 0.8 * model.fundamental_wrong <= kind < model.fundamental_wrong
        found = anything if wrong else factor * blade_pass * (1.0 + model.fundamental_sigma * error)
        return measurement._replace(fundamental=found, fundamental_variance=(model.fundamental_sigma * found) ** 2)

    def _see(self, time: float) -> CameraMeasurement:
        model, random, drones = self._model, self._random, len(self._scenario.targets)
        vectors, distances = self._seen_from_rig(
            time, [*(target.trajectory for target in self._scenario.targets), *self._birds])
        fog = float(self._scenario.weather.fog(time))
        shown: list[int] = []
        found = []
        for k in np.argsort(distances):  # the nearest hides those behind it
            azimuth, elevation = math.atan2(vectors[k, 1], vectors[k, 0]), math.asin(vectors[k, 2])
            in_view = abs(azimuth) < model.half_view and abs(elevation) < model.half_height
            seen = random.random() < model.detection_probability * math.exp(-fog * distances[k])
            apart = all(vectors[k] @ vectors[other] < math.cos(model.separation) for other in shown)
            if in_view and seen and apart:
                shown.append(int(k))
                score = random.beta(8.0, 2.0) if k < drones else random.beta(2.0, 3.0)
                found.append(self._detection(azimuth, elevation, score))
        for _ in range(random.poisson(model.sight_clutter)):
            found.append(self._detection(random.uniform(-model.half_view, model.half_view),
                                         random.uniform(-0.5 * model.half_height, model.half_height), random.beta(2.0, 5.0)))
        visibility = math.exp(-fog * float(distances.mean()))
        return CameraMeasurement(time, tuple(found), model.half_view, model.half_height, visibility)

    def _detection(self, azimuth: float, elevation: float, score: float) -> Detection:
        sigma = self._model.sight_sigma
        across, up = azimuth + sigma * self._random.normal(), elevation + sigma * self._random.normal()
        return Detection(across, sigma**2, score, up, sigma**2)


def blade_pass_of(target: Target) -> float:
    """Blade-pass frequency (Hz) of a target in level flight; NaN for one without rotors."""
    signal = target.signal or load_profile(find_config(target.drone, 'drones')).signal
    return signal.blades * float(np.mean(signal.rotor_hz)) if isinstance(signal, RotorSignal) else math.nan
