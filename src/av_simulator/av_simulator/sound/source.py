"""Sound sources: position, signal and directivity; acoustic profiles of drone kinds (YAML files in config/drones)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from av_common.config_reader import bounded, load
from av_simulator.sound.rotor import RotorSignal
from av_simulator.sound.source_signals import SourceSignal
from av_simulator.trajectories import Position


@dataclass(frozen=True)
class RotorDirectivity:
    """Directivity of rotors with a vertical axis.

    Blade tones are radiated mainly in the rotors' plane, broadband noise mainly along the axis. Between plane and axis the
    energy follows the squared cosine of the angle. The part for tones applies below `meet_hz`, the one for noise above.

    Parameters:
        tone_axis_db (dB): level of the tones along the axis, relative to the plane.
        noise_side_db (dB): level of the noise in the plane, relative to the axis.
        meet_hz (Hz): frequency of the transition.
    """

    tone_axis_db: float = bounded(-6.0, low=-200.0, high=200.0)
    noise_side_db: float = bounded(-6.0, low=-200.0, high=200.0)
    meet_hz: float = bounded(800.0, above=0.0)

    def __call__(self, directions: NDArray, frequency_hz: NDArray) -> NDArray:
        """Amplitude factors (n, F) for unit vectors (n, 3) from the source in ENU and frequencies (Hz, (F,))."""
        along_axis = directions[:, 2:] ** 2
        tones = 1.0 - along_axis * (1.0 - 10.0 ** (self.tone_axis_db / 10.0))
        noise = 1.0 - (1.0 - along_axis) * (1.0 - 10.0 ** (self.noise_side_db / 10.0))
        share = 1.0 / (1.0 + (frequency_hz / self.meet_hz) ** 4)
        return np.sqrt(share * tones + (1.0 - share) * noise)


@dataclass(frozen=True)
class Source:
    """A point that emits sound.

    Parameters:
        position: trajectory, a function from times (s, (k,)), which may be negative, to positions (m, (k, 3)) in ENU.
        signal: sound pressure at 1 m.
        gain_db (dB): gain of the signal.
        directivity: gain by direction and frequency, None for an omnidirectional source.
    """

    position: Position
    signal: SourceSignal
    gain_db: float = 0.0
    directivity: RotorDirectivity | None = None


@dataclass(frozen=True)
class DroneProfile:
    """Acoustic profile of a kind of drone.

    Parameters:
        description: text for people.
        signal: emitted signal.
        directivity: directivity of the rotors.
    """

    description: str
    signal: RotorSignal
    directivity: RotorDirectivity = field(default_factory=RotorDirectivity)


def load_profile(file: str | Path) -> DroneProfile:
    """The profile in a YAML file. Raises ConfigError or OSError with file, key and value."""
    return load(DroneProfile, file)
