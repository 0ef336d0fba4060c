"""A scenario flown, heard, seen, fused and followed in one process: no middleware, no wall clock, the same every time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from av_audio.ego_noise import NoiseRecording
from av_audio.localizer import DoaEstimate, Localizer, LocalizerSettings
from av_audio.messages import doa_array
from av_common.rig import Rig
from av_common.track import Track
from av_evaluation.experiments.oracle import Oracle
from av_evaluation.metrics.run_log import RunLog
from av_evaluation.runs.recording import Recording, RecordingTracker
from av_fusion.measurement.geometry import camera_in_body, doa_in_body
from av_pointing.controller import PointingController
from av_simulator.rendering.view import View
from av_simulator.scenario import Scenario
from av_simulator.world import World

STEP = 1600  # samples: what RFlySim sends at a time
SAMPLE_RATE = 48_000
# Before a rig with rotors flies after drones, it is recorded alone for so long.
EGO_NOISE_S = 10.0
SILENT_DB = -120.0


class OfflineRun:
    """Feeds a tracker from a simulated world. `detect` finds boxes in a picture; without it the visual oracle stands in.

    `obey` lets the pointing controller's commands turn the rig; else the rig does what the scenario says.
    """

    def __init__(self, scenario: Scenario, rig: Rig, tracker: object, seed: int | None = None,
                 pointing: PointingController | None = None, baselines: tuple[str, ...] = (),
                 detect: Callable[[NDArray, float], list[tuple[float, float, float, float, float]]] | None = None,
                 picture_every: int = 2, listening: LocalizerSettings | None = None) -> None:
        self.world = World(scenario, rig, seed, SAMPLE_RATE)
        self.log, self.recording = RunLog(), Recording()
        self._rig, self._tracker = rig, RecordingTracker(tracker, self.recording)
        self._pointing, self._detect = pointing, detect
        self._renderer = self.world.renderer() if detect else None
        self._oracle = Oracle(rig.camera.model, self.world.solids())
        settings = replace(listening or LocalizerSettings(), temperature_c=scenario.weather.temperature_c)
        ego_noise = ego_noise_of(scenario, rig, self.world.seed) if scenario.noise.ego_rotors else None
        if ego_noise is not None:
            self.log.notes['ego-noise'] = f'known from {EGO_NOISE_S:.0f} s of the rig alone'
        self._localizers = {method: Localizer(rig.array.geometry, SAMPLE_RATE, replace(settings, method=method), ego_noise)
                            for method in ('ml', *baselines)}
        self._window = settings.window_s
        self._picture_every = picture_every
        self._duration = scenario.duration

    def run(self, duration: float | None = None) -> RunLog:
        """Run to the end; the log holds truth, senses and bearing."""
        for _ in self.steps(duration):
            pass
        return self.log

    def steps(self, duration: float | None = None) -> Iterator[Track]:
        """Run a step (1/30 s) at a time, with the track after each."""
        count = 0
        while self.world.time < (duration or self._duration):
            first = round(self.world.time * SAMPLE_RATE)
            samples = self.world.advance(STEP)
            now = self.world.time
            state = self.world.rig_state(now)
            yaw, yaw_rate = math.atan2(state.rotation[1, 0], state.rotation[0, 0]), float(state.rate_flu[2])
            self._tracker.add_pose(now, yaw, yaw_rate)
            self.log.rig.add(now, *state.position, yaw)
            self.log.target.add(now, *self.world.target_state(0, now).position)
            for method, localizer in self._localizers.items():
                for estimate in localizer.process(samples, first):
                    self._hear(method, estimate, now)
            if count % self._picture_every == 0:
                self._look(self.world.view(count, now), now)
            track = self._tracker.estimate(now)
            self.log.fused.add(now, track.azimuth, math.sqrt(track.azimuth_variance), track.state, track.resolved,
                               now - track.measured)
            if self._pointing is not None:
                self.world.dynamics.command(self._pointing.step(now, track).yaw_rate, now)
            count += 1
            yield track

    def _hear(self, method: str, estimate: DoaEstimate, now: float) -> None:
        mounted = self._rig.array
        message = doa_array(estimate, mounted.geometry, estimate.time, mounted.frame, self._window, method)
        sounds = doa_in_body(message, mounted.mount.rotation)
        self.recording.sounds.setdefault(method, []).extend(sounds[:1])
        for sound in sounds if method == 'ml' else ():
            self._tracker.add_doa(sound)
            azimuths = [hypothesis.azimuth for hypothesis in sound.hypotheses]
            self.log.sound.add(sound.time, azimuths[0], azimuths[1] if len(azimuths) > 1 else math.nan, sound.confidence,
                               now - sound.time - 0.5 * self._window)

    def _look(self, view: View, now: float) -> None:
        boxes = self._boxes(view, now)
        table = np.array(boxes, float).reshape(-1, 5)
        look = camera_in_body(now, self._rig.camera.model, 0.5 * (table[:, :2] + table[:, 2:4]), table[:, 2:4] - table[:, :2],
                            table[:, 4], self._rig.camera.optical_to_body)
        self._tracker.add_camera(look)
        best = look.best
        self.log.sight.add(now, best.azimuth if best else math.nan, best.score if best else 0.0, 0.0)

    def _boxes(self, view: View, now: float) -> list[tuple[float, float, float, float, float]]:
        """Corners in pixels and confidence of what is detected."""
        if self._detect is not None:
            return self._detect(self._renderer.render(view).bgr, now)
        return [(box.min_x, box.min_y, box.max_x, box.max_y, box.score) for box in self._oracle.boxes(view)]


def ego_noise_of(scenario: Scenario, rig: Rig, seed: int) -> NoiseRecording:
    """The rig of a scenario recorded at another time, with no drone to be heard."""
    silent = tuple(replace(target, gain_db=SILENT_DB) for target in scenario.targets)
    world = World(replace(scenario, targets=silent), rig, seed + 1000, SAMPLE_RATE)
    steps = round(EGO_NOISE_S * SAMPLE_RATE / STEP)
    return NoiseRecording(np.concatenate([world.advance(STEP) for _ in range(steps)]), SAMPLE_RATE)
