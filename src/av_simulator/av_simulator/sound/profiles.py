"""Acoustic profiles of drone kinds: YAML files in config/drones."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from av_common.config_reader import load
from av_simulator.sound.directivity import RotorDirectivity
from av_simulator.sound.rotor import RotorSignal


@dataclass(frozen=True)
class DroneProfile:
    """How a kind of drone sounds."""

    RENAMED_KEYS: ClassVar[dict[str, str]] = {'voice': 'signal'}

    description: str
    signal: RotorSignal
    directivity: RotorDirectivity = field(default_factory=RotorDirectivity)


def load_profile(file: str | Path) -> DroneProfile:
    """Read a profile. Raises ConfigError or OSError that name file, key and value."""
    return load(DroneProfile, file)
