"""A scenario simulated, measured, tracked and followed in one process: no middleware, no wall clock, repeatable to the bit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from nav_msgs.msg import Odometry

from av_audio.ego_noise import NoiseRecording
from av_audio.localizer import LocalizerSettings
from av_common.angles import angles_to_direction
from av_common.freshness import Instant
from av_common.rig import Rig
from av_common.stamps import to_seconds
from av_evaluation.experiments.measurement_simulation import NEAREST_M
from av_evaluation.metrics.run_log import RunLog
from av_evaluation.metrics.tracks import TrackComparison
from av_evaluation.runs.offline_rig import HEARING, OfflineRig
from av_fusion.settings import Tracker
from av_interfaces.msg import Bearing
from av_pointing.controller import PointingController
from av_pointing.stage import PointingStage
from av_sim_bridge.messages import oracle_detections_message
from av_simulator.rendering.oracle import Oracle
from av_simulator.rendering.view import View
from av_simulator.run import times
from av_simulator.scenario import Scenario
from av_simulator.world import World
from av_vision.stage import DetectionStage

STEP = 1600  # samples: what RFlySim sends at a time
SAMPLE_RATE = 48_000  # Hz, of RFlySim
POSE_RATE = 100.0  # Hz, of odometry and of the gimbal's orientation, as the live simulator sends them
EGO_NOISE_S = 10.0  # length of the record of the rig alone, for rigs with rotors
IMAGE_EVERY = 2  # steps from one image to the next: 15 Hz, as the live simulator sends them
SILENT_DB = -120.0  # below what 16 bits hold


class OfflineRun:
    """Simulates a scenario and passes its sound and images through the stages of the rig.

    Attributes:
        world: the simulated world.
        rig: the stages, with the log.

    Parameters:
        scenario: what to simulate.
        rig: description of the rig.
        tracker: estimates the bearing.
        seed: of the world; the scenario's where None.
        pointing: turns the rig and its gimbal by its commands; where None the rig moves as the scenario says.
        estimators: further methods of direction finding to record.
        detection: detects in rendered images; where None the simulator's visual oracle gives the detections.
        settings: of the localizer; the temperature is the scenario's.
    """

    def __init__(self, scenario: Scenario, rig: Rig, tracker: Tracker, seed: int | None = None,
                 pointing: PointingController | None = None, estimators: tuple[str, ...] = (),
                 detection: DetectionStage | None = None, settings: LocalizerSettings = HEARING) -> None:
        self.world = World(scenario, rig, seed, SAMPLE_RATE)
        settings = replace(settings, temperature_c=scenario.weather.temperature_c)
        ego_noise = ego_noise_of(scenario, rig, self.world.seed) if scenario.noise.ego_rotors else None
        self.rig = OfflineRig(rig.array.geometry, tracker, rig.camera, rig.array.mount, detection, estimators, settings,
                              ego_noise, rig.gimbal is not None)
        if ego_noise is not None:
            self.log.notes['ego-noise'] = f'known from {EGO_NOISE_S:.0f} s of the rig alone'
        self._pointing = PointingStage(pointing) if pointing is not None else None
        self._renderer = self.world.renderer_factory()() if detection is not None else None
        self._oracle = Oracle(rig.camera.model, self.world.solids(), rig.camera.kind == 'thermal')
        self._duration = scenario.duration
        self._comparison = TrackComparison() if len(scenario.targets) > 1 else None
        self._compared = math.nan   # time of the tracks that were compared last

    @property
    def log(self) -> RunLog:
        """Truth, measurements and bearings."""
        return self.rig.log

    def run(self, duration: float | None = None) -> RunLog:
        """Run for `duration` (s), by default the scenario's; returns the log."""
        for _ in self.steps(duration):
            pass
        self.log.notes |= {name: text for name, text in self.rig.tracker.diagnostics().items()
                           if name.startswith('fixed emitter')}
        if self._comparison is not None:
            self.log.tracks = self._comparison.figures()
        return self.log

    def steps(self, duration: float | None = None) -> Iterator[tuple[float, Bearing | None]]:
        """Run in steps of 1/30 s, each of which gives its time (s) and the newest bearing."""
        count = 0
        while self.world.time < (duration or self._duration):
            begin = self.world.time
            samples = self.world.advance(STEP)
            now = self.world.time
            for moment in [*times(begin, now - 1e-6, POSE_RATE), now]:
                odometry = self._log_truth(moment)
            self.rig.on_samples(samples, SAMPLE_RATE, now)
            if count % IMAGE_EVERY == 0:
                self._observe(self.world.view(count, now), now)
            self.rig.advance(now)
            if self._pointing is not None and self.rig.bearing is not None:
                instant = Instant(now, now)
                self._pointing.on_odometry(odometry, instant)
                command = self._pointing.on_bearing(self.rig.bearing, instant)
                self.world.dynamics.command(command.yaw_rate, now)
                if command.move_gimbal:
                    self.world.dynamics.look(command.pan, command.tilt, now)
            self._compare_tracks()
            count += 1
            yield now, self.rig.bearing

    def _compare_tracks(self) -> None:
        """Compare the newest tracks of drones with the true directions of all targets."""
        if self._comparison is None or self.rig.targets is None:
            return
        time = to_seconds(self.rig.targets.header.stamp)
        if time != self._compared:
            self._compared = time
            places = np.array([target.trajectory(time)[0] for target in self.world.scenario.targets])
            away = places - np.array(self.world.rig_state(time).position)
            tracks = {track.id: angles_to_direction(track.azimuth_world, track.elevation_world)
                      for track in self.rig.targets.tracks if not track.drone_probability < 0.5}
            away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), NEAREST_M)
            self._comparison.add(away, tracks)

    def _log_truth(self, moment: float) -> Odometry:
        """Log the true poses, and report those of rig and gimbal."""
        state = self.world.rig_state(moment)
        self.log.rig.add(moment, *state.position, *state.attitude_wxyz)
        self.log.target.add(moment, *self.world.scenario.targets[0].trajectory(moment)[0])
        gimbal = self.world.gimbal_sample(round(moment * SAMPLE_RATE), moment)
        if gimbal is not None:
            self.rig.on_gimbal(gimbal, moment)
        return self.rig.on_state(state)

    def _observe(self, view: View, now: float) -> None:
        if self._renderer is not None:
            self.rig.on_image(self._renderer.render(view).bgr, now, now)
        else:
            self.rig.on_detections(partial(oracle_detections_message, boxes=self._oracle.boxes(view)), now, now)


def ego_noise_of(scenario: Scenario, rig: Rig, seed: int) -> NoiseRecording:
    """A record of the scenario's rig alone, made at another time.

    Parameters:
        scenario: whose targets and bystanders are silenced.
        rig: description of the rig.
        seed: of the run; the record uses another one.
    """
    silent = tuple(replace(target, gain_db=SILENT_DB) for target in scenario.targets)
    noise = scenario.noise
    if noise.snr is not None:    # is relative to the first target, and the noise remains
        ratio = noise.snr.ratio_db - scenario.targets[0].gain_db + SILENT_DB
        noise = replace(noise, snr=replace(noise.snr, ratio_db=ratio))
    world = World(replace(scenario, targets=silent, bystanders=(), noise=noise), rig, seed + 1000, SAMPLE_RATE)
    steps = round(EGO_NOISE_S * SAMPLE_RATE / STEP)
    return NoiseRecording(np.concatenate([world.advance(STEP) for _ in range(steps)]), SAMPLE_RATE)
