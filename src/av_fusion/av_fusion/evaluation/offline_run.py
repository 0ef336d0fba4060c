"""A scenario flown, heard, seen, fused and followed in one process: no middleware, no wall clock, the same every time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from av_audio.localizer import DoaEstimate, Localizer, LocalizerSettings
from av_common.angles import angles_to_direction
from av_fusion.evaluation.run_log import RunLog
from av_fusion.measurements import Look, Sound, Track
from av_fusion.pointing import PointingController
from av_fusion.sensor_geometry import look_in_body, sounds_in_body
from av_sim_bridge.picture import Picture, Renderer, View, oracle_box
from av_sim_bridge.rig import Rig
from av_sim_bridge.scenario import Scenario
from av_sim_bridge.world import World

STEP = 1600  # samples: what RFlySim sends at a time
SAMPLE_RATE = 48_000


@dataclass
class Recording:
    """What the senses reported in a run, so that other trackers can be given the very same."""

    sounds: list[Sound] = field(default_factory=list)
    looks: list[Look] = field(default_factory=list)


class OfflineRun:
    """Feeds a tracker from a simulated world. `detect` finds boxes in a picture; without it the visual oracle stands in.

    `obey` lets the pointing controller's commands turn the rig; else the rig does what the scenario says.
    """

    def __init__(self, scenario: Scenario, rig: Rig, tracker: object, seed: int | None = None,
                 pointing: PointingController | None = None, localizer: LocalizerSettings | None = None,
                 detect: Callable[[NDArray], list[tuple[float, float, float, float, float]]] | None = None,
                 picture_every: int = 2) -> None:
        self.world = World(scenario, rig, seed, SAMPLE_RATE)
        self.log, self.recording = RunLog(), Recording()
        self._rig, self._tracker, self._pointing, self._detect = rig, tracker, pointing, detect
        self._renderer: Renderer | None = self.world.renderer() if detect else None
        settings = localizer or LocalizerSettings(hop_s=0.05, temperature_c=scenario.weather.temperature_c)
        self._localizer = Localizer(rig.array.geometry, SAMPLE_RATE, settings)
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
            yaw, yaw_rate = float(self.world.dynamics.turn.yaw(now)), float(self.world.dynamics.turn.rate(now))
            self._tracker.add_pose(now, yaw, yaw_rate)
            self.log.rig.add(now, *state.position, yaw)
            self.log.target.add(now, *self.world.target_state(0, now).position)
            for estimate in self._localizer.process(samples, first):
                self._hear(estimate, now)
            if count % self._picture_every == 0:
                self._look(self.world.view(count, now), now)
            track = self._tracker.estimate(now)
            self.log.fused.add(now, track.azimuth, math.sqrt(track.azimuth_variance), track.state, track.resolved,
                               now - track.measured)
            if self._pointing is not None:
                self.world.dynamics.command(self._pointing.step(now, track).yaw_rate, now)
            count += 1
            yield track

    def _hear(self, estimate: DoaEstimate, now: float) -> None:
        sounds = sounds_in_body(estimate.time, angles_to_direction(estimate.azimuth, estimate.elevation),
                                estimate.azimuth_variance, estimate.elevation_variance, estimate.confidence,
                                estimate.group, self._rig.array.mount.rotation, self._window)
        for sound in sounds:
            self.recording.sounds.append(sound)
            self._tracker.add_sound(sound)
            azimuths = [hypothesis.azimuth for hypothesis in sound.hypotheses]
            self.log.sound.add(sound.time, azimuths[0], azimuths[1] if len(azimuths) > 1 else math.nan, sound.confidence,
                               now - sound.time - 0.5 * self._window)

    def _look(self, view: View, now: float) -> None:
        boxes = self._boxes(view)
        table = np.array(boxes, float).reshape(-1, 5)
        look = look_in_body(now, self._rig.camera.model, 0.5 * (table[:, :2] + table[:, 2:4]), table[:, 2:4] - table[:, :2],
                            table[:, 4], self._rig.camera.optical_to_body)
        self.recording.looks.append(look)
        self._tracker.add_look(look)
        best = look.best
        self.log.sight.add(now, best.azimuth if best else math.nan, best.confidence if best else 0.0, 0.0)

    def _boxes(self, view: View) -> list[tuple[float, float, float, float, float]]:
        """Corners in pixels and confidence of what is detected."""
        if self._detect is not None and self._renderer is not None:
            picture: Picture = self._renderer.render(view)
            return self._detect(picture.bgr)
        found = [oracle_box(self._rig.camera.model, view, drone) for drone in view.drones]
        return [(box.min_x, box.min_y, box.max_x, box.max_y, box.credibility) for box in found if box is not None]
