"""Scenarios of the simulated world, read from YAML: trajectories, weather, scene, sound and faults."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.acoustics import speed_of_sound
from av_common.config_reader import ConfigError, bounded, load
from av_common.files import shown
from av_simulator.config_files import find_config
from av_simulator.motion.bodies import Body, Level, Pursuit, Vibration
from av_simulator.rendering.atmosphere import Atmosphere, Cloud
from av_simulator.rendering.scenes import AnyScene, Woodland
from av_simulator.sound.bystander_signals import EngineSignal, HelicopterSignal, SirenSignal, VoiceSignal
from av_simulator.sound.ground import Ground
from av_simulator.sound.noise import Noise
from av_simulator.sound.obstacles import OBSTACLES, Obstacle
from av_simulator.sound.propagation import FASTEST
from av_simulator.sound.rays import Room, Surroundings
from av_simulator.sound.reverberation import ReverbZone
from av_simulator.sound.rotor import RotorSignal
from av_simulator.sound.source_signals import RecordedSignal, ToneSignal
from av_simulator.trajectories import Static, Trajectory, Vector, velocity

SIGNALS = {'rotor': RotorSignal, 'recording': RecordedSignal, 'tone': ToneSignal, 'voice': VoiceSignal,
           'engine': EngineSignal, 'helicopter': HelicopterSignal, 'siren': SirenSignal}
SourceSignal = Annotated[Any, SIGNALS]
FARTHEST = 10_000.0    # m, largest coordinate on a trajectory


def value_at(profile: float | tuple[tuple[float, float], ...], time: ArrayLike) -> NDArray:
    """Value of a profile at a time (s), or values at times of any shape.

    Parameters:
        profile: a value, or rows of time (s) and value, between which it is linear, and before and after which constant.
        time (s): the time.
    """
    times, values = np.array(profile if isinstance(profile, tuple) else [(0.0, profile)]).T
    return np.interp(np.asarray(time, float), times, values)


@dataclass(frozen=True)
class Target:
    """A drone.

    Parameters:
        trajectory: path of the drone.
        name: name in figures.
        size (m): distance between opposite rotor tips.
        drone: name of an acoustic profile in config/drones.
        signal: emitted signal, None for that of the profile.
        gain_db (dB): gain of the signal.
    """

    trajectory: Trajectory
    name: str = 'drone'
    size: float = bounded(0.6, low=0.05, high=20.0)
    drone: str = 'camera_quadrotor'
    signal: SourceSignal = None
    gain_db: float = bounded(0.0, low=-120.0, high=60.0)

    def __post_init__(self) -> None:
        if self.signal is None:
            try:
                find_config(self.drone, 'drones')
            except ValueError as error:
                raise ValueError(f'drone: {error}') from error


@dataclass(frozen=True)
class Bystander:
    """Something else that is heard. It is no target: nothing is sent about it, and it does not count in evaluations.

    Parameters:
        trajectory: path.
        signal: emitted signal.
        name: name in figures.
        gain_db (dB): gain of the signal.
    """

    trajectory: Trajectory
    signal: SourceSignal
    name: str = 'bystander'
    gain_db: float = bounded(0.0, low=-120.0, high=60.0)


@dataclass(frozen=True)
class RigMotion:
    """Motion of the rig. After the first command, the yaw follows commands.

    Parameters:
        trajectory: path of the rig.
        description: name or path of the rig's description for which the scenario is made, where none is given.
        yaw_deg (deg): initial yaw, counter-clockwise from east.
        yaw_rate_deg (deg/s): yaw rate until the first command.
        max_yaw_rate_deg (deg/s): limit of the yaw rate.
        max_yaw_acceleration_deg (deg/s^2): limit of the yaw acceleration.
        yaw_dead_time (s), yaw_lag (s): dead time and first-order lag of the answer to a yaw rate; 0.10 and 0.40 for PX4 as it
            was flown.
        body: what carries the rig: level, quadrotor, mast. Wind (`noise.wind`) moves the last two.
        vibration: of the body.
        pursuit: flight after a target in place of the trajectory.
    """

    trajectory: Trajectory = field(default_factory=lambda: Static((0.0, 0.0, 1.5)))
    description: str = 'rig'
    yaw_deg: float = 0.0
    yaw_rate_deg: float = bounded(0.0, low=-180.0, high=180.0)
    max_yaw_rate_deg: float = bounded(60.0, above=0.0, high=720.0)
    max_yaw_acceleration_deg: float = bounded(120.0, above=0.0, high=7200.0)
    yaw_dead_time: float = bounded(0.0, low=0.0, high=2.0)
    yaw_lag: float = bounded(0.0, low=0.0, high=5.0)
    body: Body = field(default_factory=Level)
    vibration: Vibration | None = None
    pursuit: Pursuit | None = None


@dataclass(frozen=True)
class Smoke:
    """A cloud of smoke or fog that drifts and grows. Its mass is constant, so that it thins as it grows.

    Parameters:
        position (m, ENU): initial centre.
        density (1/m): initial extinction coefficient at the centre.
        radius (m): initial standard deviation.
        growth (m/s): rate of growth of the radius.
        velocity (m/s, ENU): velocity of the drift.
        begin, end (s): interval in which the cloud exists.
    """

    position: Vector
    density: float = bounded(0.5, low=0.0, high=100.0)
    radius: float = bounded(2.0, above=0.0)
    growth: float = bounded(0.0, low=0.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    begin: float = 0.0
    end: float = bounded(1e9, above=0.0, high=1e9)

    def at(self, time: float) -> Cloud | None:
        """The cloud at a time (s), None outside its interval."""
        if not self.begin <= time <= self.end:
            return None
        age = time - self.begin
        radius = self.radius + self.growth * age
        centre = np.array(self.position) + age * np.array(self.velocity)
        return Cloud(centre, radius, self.density * (self.radius / radius) ** 3)


@dataclass(frozen=True)
class Weather:
    """Air and light. Profiles are a number, or a list of [time, value].

    Parameters:
        temperature_c (deg C), humidity_percent (%), pressure_kpa (kPa): state of the air.
        fog (1/m): extinction coefficient; the transmission is exp(-fog * distance).
        smoke: clouds of smoke or fog.
        rain_mm_h (mm/h): rain.
        daylight: illumination, 1 at noon, 0.005 at night.
        exposure: gain of the camera; 1 is correct at noon.
        absorption: whether air absorbs sound (ISO 9613-1).
    """

    temperature_c: float = bounded(15.0, low=-40.0, high=55.0)
    humidity_percent: float = bounded(60.0, low=1.0, high=100.0)
    pressure_kpa: float = bounded(101.325, low=30.0, high=110.0)
    fog: float | tuple[tuple[float, float], ...] = bounded(0.0, low=0.0)
    smoke: tuple[Smoke, ...] = ()
    rain_mm_h: float | tuple[tuple[float, float], ...] = bounded(0.0, low=0.0)
    daylight: float | tuple[tuple[float, float], ...] = bounded(1.0, low=0.0)
    exposure: float | tuple[tuple[float, float], ...] = bounded(1.0, low=0.0)
    absorption: bool = True

    def __post_init__(self) -> None:
        for name in ('fog', 'rain_mm_h', 'daylight', 'exposure'):
            if isinstance(profile := getattr(self, name), tuple):
                times = tuple(time for time, _ in profile)
                if not times or min(np.diff(times), default=1.0) <= 0.0:
                    raise ConfigError(f'weather.{name}: times are {shown(times)}, expected increasing times')

    def atmosphere(self, time: float) -> Atmosphere:
        """Optical properties of the air at a time (s)."""
        clouds = (smoke.at(time) for smoke in self.smoke)
        return Atmosphere(float(value_at(self.fog, time)), float(value_at(self.rain_mm_h, time)),
                          tuple(cloud for cloud in clouds if cloud is not None))


@dataclass(frozen=True)
class Faults:
    """Faults of the sensors and the network.

    Parameters:
        clock_ppm (ppm): deviation of the microphones' sample rate; positive for a fast clock.
        lost_datagrams (0 to 1): fraction of datagrams that are not sent.
    """

    clock_ppm: float = bounded(0.0, low=-1000.0, high=1000.0)
    lost_datagrams: float = bounded(0.0, low=0.0, high=1.0)


@dataclass(frozen=True)
class Scenario:
    """One reproducible run: the same scenario and seed give the same world.

    Parameters:
        name, description: texts for logs and figures.
        targets: one or more drones.
        bystanders: what else is heard.
        duration (s): duration of the run.
        seed: seed of all random numbers.
        rig: motion of the rig.
        weather: air and light.
        scene: visible surroundings.
        obstacles: obstacles that are visible and affect sound.
        ground, room, reverberation: surroundings that affect sound only.
        noise: noise at the microphones.
        faults: faults of sensors and network.
    """

    name: str
    targets: tuple[Target, ...] = bounded(longest=100)
    duration: float = bounded(60.0, above=0.0, high=86_400.0)
    seed: int = bounded(1, low=0)
    description: str = ''
    rig: RigMotion = field(default_factory=RigMotion)
    bystanders: tuple[Bystander, ...] = bounded((), longest=100)
    weather: Weather = field(default_factory=Weather)
    scene: AnyScene = field(default_factory=Woodland)
    obstacles: tuple[Annotated[Obstacle, OBSTACLES], ...] = ()
    ground: Ground | None = None
    room: Room | None = None
    reverberation: tuple[ReverbZone, ...] = ()
    noise: Noise = field(default_factory=Noise)
    faults: Faults = field(default_factory=Faults)

    def __post_init__(self) -> None:
        if not self.targets:
            raise ValueError('targets: none, expected at least one')
        pursuit = self.rig.pursuit
        if pursuit is not None and pursuit.target >= len(self.targets):
            raise ValueError(f'rig.pursuit.target: {pursuit.target}, expected less than the {len(self.targets)} targets')
        _ = self.surroundings   # raises ValueError for contradictions
        fastest = FASTEST * speed_of_sound(self.weather.temperature_c)
        times = np.linspace(0.0, self.duration, 2000)
        trajectories = {'rig': self.rig.trajectory}
        trajectories |= {f'targets[{number}]': each.trajectory for number, each in enumerate(self.targets)}
        trajectories |= {f'bystanders[{number}]': each.trajectory for number, each in enumerate(self.bystanders)}
        for key, trajectory in trajectories.items():
            farthest = np.abs(trajectory(times)).max()
            if not farthest <= FARTHEST:
                raise ValueError(f'{key}.trajectory: {farthest:.3g} m from the origin, expected at most {FARTHEST:g} m')
            speed = np.linalg.norm(velocity(trajectory, times), axis=1)
            if not speed.max() <= fastest:
                raise ValueError(f'{key}.trajectory: {speed.max():.0f} m/s at {times[speed.argmax()]:.1f} s, '
                                 f'expected at most {fastest:.0f} m/s ({FASTEST} of the speed of sound)')

    @property
    def surroundings(self) -> Surroundings:
        """The surroundings that affect sound. Raises ValueError for a ground in addition to a room."""
        return Surroundings(self.ground, self.obstacles, self.room, self.reverberation)


def load_scenario(path: str | Path) -> Scenario:
    """The scenario in a YAML file. Raises ConfigError or OSError with file, key and value."""
    return load(Scenario, path)
