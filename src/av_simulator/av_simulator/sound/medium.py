"""The air between source and microphone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import zero_Celsius

from av_common.acoustics import speed_of_sound

_TRIPLE_POINT_K = 273.16  # of water (ISO 9613-1)
_REFERENCE_K = 293.15  # of the formulas (ISO 9613-1)
_REFERENCE_KPA = 101.325  # the same


@dataclass(frozen=True)
class Medium:
    """Air at rest. Raises ValueError for a state of the air outside the limits.

    Parameters:
        temperature_c (deg C): -60 to 60.
        humidity_percent (%): relative humidity, 0 to 100.
        pressure_kpa (kPa): 20 to 200.
        absorption: whether air absorbs sound (ISO 9613-1).
    """

    temperature_c: float = 20.0
    humidity_percent: float = 50.0
    pressure_kpa: float = _REFERENCE_KPA
    absorption: bool = False

    def __post_init__(self) -> None:
        if not -60.0 <= self.temperature_c <= 60.0:
            raise ValueError(f'temperature_c is {self.temperature_c}, expected degrees Celsius between -60 and 60')
        if not 0.0 <= self.humidity_percent <= 100.0:
            raise ValueError(f'humidity_percent is {self.humidity_percent}, expected 0 to 100')
        if not 20.0 <= self.pressure_kpa <= 200.0:
            raise ValueError(f'pressure_kpa is {self.pressure_kpa}, expected kilopascals between 20 and 200')

    @property
    def speed_of_sound(self) -> float:
        """Speed of sound (m/s)."""
        return speed_of_sound(self.temperature_c)

    def absorption_db_per_m(self, frequency_hz: ArrayLike) -> NDArray:
        """Attenuation (dB/m) of pure tones at frequencies (Hz) of any shape, regardless of `absorption`.

        The standard states an accuracy of 10 % from 50 Hz to 10 kHz, -20 to 50 degrees Celsius and 10 to 100 % humidity.
        """
        squared = np.asarray(frequency_hz, float) ** 2
        kelvin = self.temperature_c + zero_Celsius
        warmth, pressure = kelvin / _REFERENCE_K, self.pressure_kpa / _REFERENCE_KPA
        saturation = 10.0 ** (4.6151 - 6.8346 * (_TRIPLE_POINT_K / kelvin) ** 1.261)
        vapour = self.humidity_percent * saturation / pressure  # molar concentration in %
        oxygen_hz = pressure * (24.0 + 4.04e4 * vapour * (0.02 + vapour) / (0.391 + vapour))
        nitrogen_hz = pressure / np.sqrt(warmth) * (9.0 + 280.0 * vapour * np.exp(-4.170 * (warmth ** (-1.0 / 3.0) - 1.0)))
        relaxation = (0.01275 * np.exp(-2239.1 / kelvin) / (oxygen_hz + squared / oxygen_hz)
                      + 0.1068 * np.exp(-3352.0 / kelvin) / (nitrogen_hz + squared / nitrogen_hz))
        return 8.686 * squared * (1.84e-11 / pressure * np.sqrt(warmth) + warmth ** -2.5 * relaxation)
