"""What happens in a simulated world, read from YAML: who flies where, how the weather is, what there is to hear."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from av_sim_bridge.config_reader import bounded, load
from av_sim_bridge.profile import Profile
from av_sim_bridge.sound.noise import Noise
from av_sim_bridge.sound.rotor import RotorVoice
from av_sim_bridge.sound.voices import RecordingVoice, ToneVoice
from av_sim_bridge.trajectories import Static, Trajectory

VOICES = {'rotor': RotorVoice, 'recording': RecordingVoice, 'tone': ToneVoice}
Voice = Annotated[Any, VOICES]


@dataclass(frozen=True)
class Target:
    """A drone: `size` in m from rotor tip to rotor tip."""

    trajectory: Trajectory
    name: str = 'drone'
    size: float = bounded(0.6, low=0.05, high=20.0)
    voice: Voice = field(default_factory=RotorVoice)


@dataclass(frozen=True)
class RigMotion:
    """How the rig moves by itself. Its yaw follows commands once there are any; `yaw_rate_deg` holds until then."""

    trajectory: Trajectory = field(default_factory=lambda: Static((0.0, 0.0, 1.5)))
    yaw_deg: float = 0.0
    yaw_rate_deg: float = bounded(0.0, low=-180.0, high=180.0)
    max_yaw_rate_deg: float = bounded(60.0, above=0.0, high=720.0)
    max_yaw_acceleration_deg: float = bounded(120.0, above=0.0, high=7200.0)


@dataclass(frozen=True)
class Weather:
    """Air and sight. `fog`: extinction in 1/m; of an object's contrast one sees exp(-fog * distance)."""

    temperature_c: float = bounded(15.0, low=-40.0, high=55.0)
    humidity_percent: float = bounded(60.0, low=0.0, high=100.0)
    pressure_hpa: float = bounded(1013.25, low=300.0, high=1100.0)
    fog: Profile = field(default_factory=Profile)


@dataclass(frozen=True)
class Scene:
    """What stands around: `trees` of them between `clearing` and `extent` metres from the origin."""

    trees: int = bounded(60, low=0, high=2000)
    clearing: float = bounded(18.0, low=0.0)
    extent: float = bounded(60.0, above=0.0)

    def __post_init__(self) -> None:
        if self.extent <= self.clearing:
            raise ValueError(f'extent: {self.extent} m, more than the clearing of {self.clearing} m expected')


@dataclass(frozen=True)
class Scenario:
    """One reproducible run: the same scenario and seed give the same world."""

    name: str
    targets: tuple[Target, ...]
    duration: float = bounded(60.0, above=0.0, high=86_400.0)
    seed: int = bounded(1, low=0)
    description: str = ''
    rig: RigMotion = field(default_factory=RigMotion)
    weather: Weather = field(default_factory=Weather)
    scene: Scene = field(default_factory=Scene)
    noise: Noise = field(default_factory=Noise)

    def __post_init__(self) -> None:
        if not self.targets:
            raise ValueError('targets: none, at least one expected')


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario's file. Raises ConfigError or OSError that name file, key and value."""
    return load(Scenario, path)
