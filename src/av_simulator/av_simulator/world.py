"""Simulation of a scenario in fixed steps: sound, views and true states, without sockets and wall clock."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from av_common.rig import Rig
from av_sim_bridge.vehicle import GRAVITY, VehicleState
from av_sim_bridge.wire.gimbal import GimbalSample
from av_sim_bridge.wire.ports import FIRST_TARGET
from av_simulator.config_files import find_config
from av_simulator.motion.axes import ENCODER_SIGMA
from av_simulator.rendering.render_process import RendererFactory, make_renderer
from av_simulator.rendering.scenes import Solid
from av_simulator.rendering.view import Drone, View
from av_simulator.rig_dynamics import RigDynamics, attitudes
from av_simulator.scenario import Scenario, Target, value_at
from av_simulator.sound.medium import Medium
from av_simulator.sound.noise import Noise
from av_simulator.sound.obstacles import Box, Obstacle
from av_simulator.sound.rotor import RotorSignal, rotor_speed
from av_simulator.sound.source import Source, load_profile
from av_simulator.sound.stream import spl_to_pascal
from av_simulator.sound.world import SoundWorld
from av_simulator.trajectories import Position, acceleration, velocity

SHUTTER = 2e-3  # s, time over which the camera's turn is taken
INSTANT = 160   # samples between the instants at which the microphones' positions are computed


class World:
    """One rig and its targets. `advance` simulates one step; states and views are available within that step.

    Raises ValueError or OSError for unreadable recordings and arrays.

    Parameters:
        scenario: targets, weather, surroundings and noise.
        rig: microphones and camera.
        seed: seed, None for the scenario's.
        sample_rate (Hz): sample rate of the microphones.
    """

    def __init__(self, scenario: Scenario, rig: Rig, seed: int | None = None, sample_rate: int = 48_000):
        self.scenario, self.rig, self.sample_rate = scenario, rig, sample_rate
        self.seed = scenario.seed if seed is None else seed
        self.dynamics = RigDynamics(scenario.rig, [target.trajectory for target in scenario.targets], scenario.noise.wind,
                                    rig.gimbal, self.seed)
        self._samples = 0
        weather, array = scenario.weather, rig.array
        self._sources = [_source(target) for target in scenario.targets]
        self._sources += [Source(each.trajectory, each.signal, each.gain_db) for each in scenario.bystanders]
        self._sound = SoundWorld(
            sample_rate, self._sources,
            Medium(weather.temperature_c, weather.humidity_percent, weather.pressure_kpa, weather.absorption),
            microphones=array.geometry.channels, noise=_noise(scenario.noise, rig), seed=self.seed,
            full_scale_pa=spl_to_pascal(array.full_scale_db_spl), surroundings=scenario.surroundings,
            clock_ppm=scenario.faults.clock_ppm)

    @property
    def time(self) -> float:
        """End of the newest step (s)."""
        return self._samples / self.sample_rate

    def renderer_factory(self, camera: str = 'camera') -> RendererFactory:
        """Factory of renderers for one of the rig's cameras, which may be used in another process."""
        seen_by = self.rig.cameras[camera]
        drones = tuple((target.size, self._rotors(number)) for number, target in enumerate(self.scenario.targets))
        return partial(make_renderer, seen_by.model, self.scenario.scene, drones,
                       [_seen(obstacle) for obstacle in self.scenario.obstacles], self.seed,
                       self.scenario.weather.temperature_c, seen_by.palette if seen_by.kind == 'thermal' else '')

    def solids(self) -> list[Solid]:
        """All solids of the scene that can occlude a drone."""
        return [*self.scenario.scene.solids(np.random.default_rng([self.seed, 11])),
                *(_seen(obstacle) for obstacle in self.scenario.obstacles)]

    def advance(self, samples: int) -> NDArray:
        """Simulate a number of samples, a multiple of INSTANT; returns the sound (samples, microphones), full scale 1."""
        if samples <= 0 or samples % INSTANT:
            raise ValueError(f'samples is {samples}, expected a positive multiple of {INSTANT}')
        end = (self._samples + samples) / self.sample_rate
        motion = self.dynamics.step(self.time, end)
        positions, rotations = motion.poses(np.linspace(self.time, end, samples // INSTANT + 1))
        microphones = positions[:, np.newaxis] + np.einsum('kij,mj->kmi', rotations, self.rig.array.positions)
        self._samples += samples
        return self._sound.render(samples, microphones)

    def skip(self, seconds: float) -> None:
        """Let some time (s) pass without sound, rounded to whole intervals of INSTANT samples, one at least."""
        samples = max(round(seconds * self.sample_rate / INSTANT), 1) * INSTANT
        self.dynamics.step(self.time, (self._samples + samples) / self.sample_rate)
        self._samples += samples
        self._sound.skip(samples)

    def rig_state(self, time: float) -> VehicleState:
        """The rig's state at a time (s) within the newest step."""
        return self.dynamics.motion.state(time)

    def target_states(self, number: int, times: ArrayLike) -> list[VehicleState]:
        """States of one target. Its x axis points along the flight, its z axis along the thrust.

        Parameters:
            number: index of the target.
            times (s, (k,)): times.
        """
        path, t, step = self.scenario.targets[number].trajectory, np.asarray(times, float), 2e-3
        before, rotations, after = np.split(_flight_attitudes(path, np.concatenate([t - step, t, t + step])), 3)
        turned = np.einsum('kji,kjl->kil', before, after)
        rates = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=1) / (2 * step)
        attitudes = Rotation.from_matrix(rotations).as_quat()[:, [3, 0, 1, 2]]
        rows = zip(t.tolist(), path(t), velocity(path, t), acceleration(path, t), attitudes, rates,
                   self._rotor_rpm(number, t), strict=True)
        return [VehicleState(*row) for row in rows]

    def camera_pose(self, time: float, camera: str = 'camera') -> tuple[NDArray, NDArray]:
        """Position (m, (3,)) of a camera in ENU, and rotation ((3, 3)) from its optical frame to ENU.

        Parameters:
            time (s): time within the newest step.
            camera: one of the rig's cameras.
        """
        state, mounted, gimbal = self.rig_state(time), self.rig.cameras[camera], self.dynamics.gimbal
        position, rotation = np.array(mounted.mount.position), mounted.optical_to_body
        if gimbal is not None:
            turned = gimbal.rotation(time, state.attitude_wxyz)
            position, rotation = np.array(gimbal.mount.mount.position) + turned @ position, turned @ rotation
        return state.position + state.rotation @ position, state.rotation @ rotation

    def gimbal_sample(self, number: int, time: float) -> GimbalSample | None:
        """What the gimbal reports of its orientation; None without a gimbal.

        Parameters:
            number: number of the sample, which also seeds its error.
            time (s): time within the newest step.
        """
        gimbal = self.dynamics.gimbal
        if gimbal is None:
            return None
        error = np.random.default_rng([self.seed, 18, number]).normal(0.0, ENCODER_SIGMA, 3)
        measured = gimbal.rotation(time, self.rig_state(time).attitude_wxyz) @ Rotation.from_rotvec(error).as_matrix()
        return GimbalSample(number, time, Rotation.from_matrix(measured).as_quat()[[3, 0, 1, 2]], ENCODER_SIGMA**2)

    def view(self, index: int, time: float, camera: str = 'camera') -> View:
        """A camera's view.

        Parameters:
            index: number of the image.
            time (s): time within the newest step.
            camera: one of the rig's cameras.
        """
        weather, model = self.scenario.weather, self.rig.cameras[camera].model
        position, rotation = self.camera_pose(time, camera)
        drones = [self._drone(number, time) for number in range(len(self.scenario.targets))]
        # Distant stationary objects move in the image opposite to the camera's rotation.
        turn = Rotation.from_matrix(self.camera_pose(time - SHUTTER, camera)[1].T @ rotation).as_rotvec() / SHUTTER
        motion = (-model.fx * turn[1], model.fy * turn[0])
        return View(index, time, position, rotation,
                    weather.atmosphere(time), drones, float(value_at(weather.daylight, time)),
                    float(value_at(weather.exposure, time)), motion)

    def _drone(self, number: int, time: float) -> Drone:
        target, state = self.scenario.targets[number], self.target_states(number, [time])[0]
        rotors = self._rotors(number)
        sides = (-1.0) ** np.arange(rotors)
        turns = state.rotor_rpm[:rotors] / 60.0 if state.rotor_rpm.any() else np.full(rotors, 90.0)
        return Drone(FIRST_TARGET + number, state.position, state.rotation, target.size, rotors,
                     np.mod(2 * np.pi * turns * time * sides, 2 * np.pi))

    def _rotor_rpm(self, number: int, times: NDArray) -> NDArray:
        """Rotor speeds (1/min, (k, 8)) at times (s, (k,)), 0 for signals without rotors."""
        rpm, signal = np.zeros((len(times), 8)), self._sources[number].signal
        if isinstance(signal, RotorSignal):
            rotors = np.array(signal.rotor_hz)[:8]
            rpm[:, :len(rotors)] = 60.0 * rotors * rotor_speed(self.scenario.targets[number].trajectory, times)
        return rpm

    def _rotors(self, number: int) -> int:
        signal = self._sources[number].signal
        return min(max(len(signal.rotor_hz), 3), 8) if isinstance(signal, RotorSignal) else 4


def _source(target: Target) -> Source:
    """The sound source of a target. Raises ConfigError."""
    signal, directivity = target.signal, None
    if signal is None:
        profile = load_profile(find_config(target.drone, 'drones'))
        signal, directivity = profile.signal, profile.directivity
    return Source(target.trajectory, signal, target.gain_db, directivity)


def _noise(noise: Noise, rig: Rig) -> Noise:
    """The noise, with the positions of the rig's microphones for the ego-noise of its rotors."""
    if noise.ego_rotors is None:
        return noise
    microphones = rig.array.positions.tolist()
    return dataclasses.replace(noise, ego_rotors=dataclasses.replace(noise.ego_rotors, microphones=microphones))


def _seen(obstacle: Obstacle) -> Solid:
    """The visible solid of an acoustic obstacle: thin boxes (whiteboards) are white, thick ones grey, trunks brown."""
    if isinstance(obstacle, Box):
        colour = (0.93, 0.93, 0.91) if min(obstacle.size[:2]) < 0.12 else (0.55, 0.54, 0.52)
        return Solid('box', obstacle.center, [length / 2 for length in obstacle.size], colour, np.deg2rad(obstacle.yaw_deg))
    half = (obstacle.top - obstacle.bottom) / 2
    return Solid('cylinder', [*obstacle.center, obstacle.bottom + half], (obstacle.radius, obstacle.radius, half),
                 (0.42, 0.36, 0.30))


def _flight_attitudes(path: Position, times: NDArray) -> NDArray:
    """Rotation matrices (k, 3, 3) from FLU to ENU: x along the flight, z along the thrust."""
    ahead = velocity(path, times)
    moving = np.hypot(ahead[:, 0], ahead[:, 1]) > 0.05
    heading = np.where(moving, np.arctan2(ahead[:, 1], ahead[:, 0]), 0.0)
    thrust = acceleration(path, times) + np.array([0.0, 0.0, GRAVITY])
    return attitudes(thrust / np.linalg.norm(thrust, axis=1, keepdims=True), heading)
