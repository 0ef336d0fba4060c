"""What happens in a simulated world, read from YAML: who flies where, how the weather is, what there is to hear."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from av_sim_bridge.config_reader import ConfigError, bounded, load
from av_sim_bridge.profile import Profile
from av_sim_bridge.sound.noise import Noise
from av_sim_bridge.sound.rotor import RotorVoice
from av_sim_bridge.sound.voices import RecordingVoice, ToneVoice
from av_sim_bridge.trajectories import Static, Trajectory, Vector

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
    """Air and sight. `fog` is the extinction coefficient in 1/m: one sees exp(-fog * distance) of an object's contrast."""

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


def find_config(name: str, folder: str = '') -> Path:
    """A file by path, or a shipped one by name from `folder` of config/. Raises ConfigError naming what there is.

    config/ is searched in `$AV_CONFIG`, in the installed av_fusion, and in the source tree.
    """
    direct = Path(name).expanduser()
    if direct.suffix and direct.is_file():
        return direct
    shelves = [root / folder for root in _config_roots() if (root / folder).is_dir()]
    for shelf in shelves:
        candidate = shelf / (name if direct.suffix else f'{name}.yaml')
        if candidate.is_file():
            return candidate
    known = sorted({file.stem for shelf in shelves for file in shelf.glob('*.yaml')})
    raise ConfigError(f'{name}: no such file, nor one of the shipped {", ".join(known) or "(none found)"}')


def _config_roots() -> list[Path]:
    roots = [Path(os.environ['AV_CONFIG'])] if 'AV_CONFIG' in os.environ else []
    try:
        from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
        try:
            roots.append(Path(get_package_share_directory('av_fusion')) / 'config')
        except PackageNotFoundError:
            pass
    except ImportError:
        pass
    here = Path(__file__).resolve()
    return roots + [parent / 'config' for parent in here.parents if (parent / 'config' / 'scenarios').is_dir()]
