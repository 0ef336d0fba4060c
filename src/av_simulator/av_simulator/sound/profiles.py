"""Acoustic profiles of drone kinds: YAML files in config/drones."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from av_common.config_reader import load
from av_simulator.sound.directivity import RotorDirectivity
from av_simulator.sound.rotor import RotorVoice


@dataclass(frozen=True)
class DroneProfile:
    """How a kind of drone sounds."""

    description: str
    voice: RotorVoice
    directivity: RotorDirectivity = field(default_factory=RotorDirectivity)


def load_profile(file: str | Path) -> DroneProfile:
    """Read a profile. Raises ConfigError or OSError that name file, key and value."""
    return load(DroneProfile, file)
