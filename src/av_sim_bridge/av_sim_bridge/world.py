"""A scenario that runs: sound, views and true states, in fixed steps, without sockets and without a wall clock."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from transforms3d.quaternions import mat2quat

from av_sim_bridge.painter import Painter
from av_sim_bridge.picture import Drone, Renderer, View
from av_sim_bridge.rig import Rig
from av_sim_bridge.rig_dynamics import RigDynamics, Turn
from av_sim_bridge.scenario import Scenario, Target
from av_sim_bridge.sound import Medium, RecordingVoice, RotorVoice, SoundWorld, Source
from av_sim_bridge.sound.levels import spl_to_pascal
from av_sim_bridge.trajectories import Position, acceleration, velocity
from av_sim_bridge.vehicle import GRAVITY, VehicleState

INSTANT = 160   # samples between the instants at which the microphones' positions are known
FIRST_TARGET_ID = 2   # RFlySim numbers vehicles from 1, which is the rig


class World:
    """One rig and its targets. `advance` moves on by one step; states and views may be asked for within that step."""

    def __init__(self, scenario: Scenario, rig: Rig, seed: int | None = None, sample_rate: int = 48_000):
        """seed: instead of the scenario's. Raises ValueError or OSError for voices and arrays that cannot be had."""
        self.scenario, self.rig, self.sample_rate = scenario, rig, sample_rate
        self.seed = scenario.seed if seed is None else seed
        self.dynamics = RigDynamics(scenario.rig)
        self._samples = 0
        sources = [Source(target.trajectory, _flown(target)) for target in scenario.targets]
        self._sound = SoundWorld(sample_rate, sources, Medium(temperature_c=scenario.weather.temperature_c),
                                 microphones=rig.array.geometry.channels, noise=scenario.noise, seed=self.seed,
                                 full_scale_pa=spl_to_pascal(rig.array.full_scale_db_spl))

    @property
    def time(self) -> float:
        """End of the newest step in s."""
        return self._samples / self.sample_rate

    def renderer(self) -> Renderer:
        """What makes pictures of this world's views."""
        return Painter(self.rig.camera.model, self.scenario.scene, self.seed)

    def advance(self, samples: int) -> NDArray:
        """Move on by a number of samples, a multiple of INSTANT; what the microphones hear meanwhile, (samples, m)."""
        if samples <= 0 or samples % INSTANT:
            raise ValueError(f'samples: {samples}, a positive multiple of {INSTANT} expected')
        turn = self.dynamics.step(self.time)
        end = (self._samples + samples) / self.sample_rate
        microphones = self._microphones(turn, np.linspace(self.time, end, samples // INSTANT + 1))
        self._samples += samples
        return self._sound.render(samples, microphones)

    def rig_state(self, time: float) -> VehicleState:
        """The rig's state at a time within the newest step."""
        motion = self.scenario.rig
        turn = self.dynamics.turn
        yaw = float(turn.yaw(time))
        return VehicleState(time, motion.trajectory(time)[0], velocity(motion.trajectory, time)[0],
                            acceleration(motion.trajectory, time)[0], mat2quat(_yaw_rotation(yaw)),
                            np.array([0.0, 0.0, float(turn.rate(time))]))

    def target_state(self, number: int, time: float) -> VehicleState:
        """State of one target: it flies forward, tilted as its acceleration needs."""
        target = self.scenario.targets[number]
        path = target.trajectory
        rotation = _flight_attitude(path, time)
        step = 2e-3
        turned = _flight_attitude(path, time - step).T @ _flight_attitude(path, time + step)
        rate = np.array([turned[2, 1], turned[0, 2], turned[1, 0]]) / (2 * step)
        return VehicleState(time, path(time)[0], velocity(path, time)[0], acceleration(path, time)[0],
                            mat2quat(rotation), rate, _rotor_rpm(target, time))

    def view(self, index: int, time: float) -> View:
        """What the camera has before it at a time within the newest step."""
        state = self.rig_state(time)
        camera = self.rig.camera
        drones = []
        for number, target in enumerate(self.scenario.targets):
            drone = self.target_state(number, time)
            drones.append(Drone(FIRST_TARGET_ID + number, drone.position, drone.rotation, target.size))
        return View(index, time, state.position + state.rotation @ np.array(camera.mount.position),
                    state.rotation @ camera.optical_to_body, float(self.scenario.weather.fog(time)), drones)

    def _microphones(self, turn: Turn, times: NDArray) -> NDArray:
        """World positions (k, m, 3) of the microphones at times (k,)."""
        body = self.rig.array.positions
        c, s = np.cos(turn.yaw(times))[:, np.newaxis], np.sin(turn.yaw(times))[:, np.newaxis]
        x, y, z = body.T
        turned = np.stack([c * x - s * y, s * x + c * y, np.broadcast_to(z, (len(times), len(z)))], axis=2)
        return self.scenario.rig.trajectory(times)[:, np.newaxis] + turned


def with_voice(scenario: Scenario, file: str | Path) -> Scenario:
    """The scenario with a recording as every drone's voice. Raises FileNotFoundError."""
    voice = RecordingVoice(file)
    return dataclasses.replace(scenario, targets=tuple(dataclasses.replace(target, voice=voice)
                                                       for target in scenario.targets))


def _flown(target: Target) -> object:
    """The target's voice, with rotors that turn faster when it climbs or brakes."""
    if isinstance(target.voice, RotorVoice) and target.voice.speed is None:
        return dataclasses.replace(target.voice, speed=partial(_rotor_speed, target.trajectory))
    return target.voice


def _rotor_speed(path: Position, times: ArrayLike) -> NDArray:
    """Rotor speed relative to hover (k, 1): thrust rises with its square and carries weight and acceleration."""
    thrust = np.linalg.norm(acceleration(path, times) + np.array([0.0, 0.0, GRAVITY]), axis=1)
    return np.sqrt(thrust / GRAVITY)[:, np.newaxis].clip(0.5, 1.5)


def _rotor_rpm(target: Target, time: float) -> NDArray:
    rpm = np.zeros(8)
    if isinstance(target.voice, RotorVoice):
        rotors = np.array(target.voice.rotor_hz)[:8]
        rpm[:len(rotors)] = 60.0 * rotors * _rotor_speed(target.trajectory, time)[0]
    return rpm


def _flight_attitude(path: Position, time: float) -> NDArray:
    """Rotation (3, 3) from FLU to ENU: x along the flight, z along the thrust."""
    ahead = velocity(path, time)[0]
    heading = np.arctan2(ahead[1], ahead[0]) if np.hypot(ahead[0], ahead[1]) > 0.05 else 0.0
    up = acceleration(path, time)[0] + [0.0, 0.0, GRAVITY]
    up /= np.linalg.norm(up)
    left = np.cross(up, [np.cos(heading), np.sin(heading), 0.0])
    left /= np.linalg.norm(left)
    return np.column_stack([np.cross(left, up), left, up])


def _yaw_rotation(yaw: float) -> NDArray:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
