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
    """Acoustic profile of a kind of drone.

    Parameters:
        description: text for people.
        signal: emitted signal.
        directivity: directivity of the rotors.
    """

    RENAMED_KEYS: ClassVar[dict[str, str]] = {'voice': 'signal'}

    description: str
    signal: RotorSignal
    directivity: RotorDirectivity = field(default_factory=RotorDirectivity)


def load_profile(file: str | Path) -> DroneProfile:
    """The profile in a YAML file. Raises ConfigError or OSError with file, key and value."""
    return load(DroneProfile, file)
