"""The air between source and microphone."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from av_common.acoustics import speed_of_sound
from av_simulator.sound.absorption import absorption_db_per_m
from av_simulator.sound.attenuation import Attenuation


@dataclass(frozen=True)
class Medium:
    """Air at rest.

    Parameters:
        temperature_c (deg C), humidity_percent (%), pressure_kpa (kPa): state of the air.
        absorption: whether air absorbs sound (ISO 9613-1).
        attenuation: function from distances (m) to gains.
    """

    temperature_c: float = 20.0
    humidity_percent: float = 50.0
    pressure_kpa: float = 101.325
    absorption: bool = False
    attenuation: Attenuation = field(default_factory=Attenuation)

    def __post_init__(self) -> None:
        self.absorption_db_per_m(np.zeros(1))  # raises ValueError for an impossible state of the air

    @property
    def speed_of_sound(self) -> float:
        """Speed of sound (m/s)."""
        return speed_of_sound(self.temperature_c)

    def absorption_db_per_m(self, frequency_hz: NDArray) -> NDArray:
        """Absorption (dB/m) of the air at each frequency (Hz), regardless of `absorption`."""
        return absorption_db_per_m(frequency_hz, self.temperature_c, self.humidity_percent, self.pressure_kpa)
