"""Reflection of spherical waves by a ground of finite impedance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import wofz

from av_common.config_reader import bounded

# Effective flow resistivity in Pa s/m^2 (Attenborough, Li and Horoshenkov, Predicting Outdoor Sound, 2007, chapter 3; rounded).
FLOW_RESISTIVITY = {
    'snow': 10e3, 'forest': 40e3, 'grass': 200e3, 'soil': 500e3, 'gravel': 1e6, 'asphalt': 20e6, 'concrete': 100e6,
}


@dataclass(frozen=True)
class Ground:
    """The plane z = 0.

    Parameters:
        surface: name of a surface in FLOW_RESISTIVITY.
        flow_resistivity (Pa s/m^2): effective flow resistivity, None for that of the surface.
    """

    surface: str = 'grass'
    flow_resistivity: float | None = bounded(None, low=1e3, high=1e9)

    def __post_init__(self) -> None:
        if self.surface not in FLOW_RESISTIVITY:
            raise ValueError(f'ground surface is {self.surface!r}, expected one of {", ".join(FLOW_RESISTIVITY)}')

    def reflection(self, sine_grazing: NDArray, path_m: NDArray, frequency_hz: NDArray, speed_of_sound: float) -> NDArray:
        """Spherical wave reflection coefficient Q, complex (..., F), with which a mirror source is weighted.

        Source: Weyl-Van der Pol; Attenborough et al. 2007, chapter 2. The sign convention is numpy's, exp(+i omega t).

        Parameters:
            sine_grazing ((...,)): sine of the grazing angle.
            path_m (m, (...,)): length of the reflected path.
            frequency_hz (Hz, (F,)): frequencies.
            speed_of_sound (m/s): speed of sound.
        """
        resistivity = self.flow_resistivity or FLOW_RESISTIVITY[self.surface]
        admittance = 1.0 / miki_impedance(frequency_hz, resistivity)
        sine, path = sine_grazing[..., None], path_m[..., None]
        plane = (sine - admittance) / (sine + admittance)
        wavenumber = 2.0 * np.pi * frequency_hz / speed_of_sound
        distance = np.sqrt(0.5j * wavenumber * path) * (sine + admittance)  # numerical distance, exp(-i omega t)
        boundary_loss = 1.0 + 1j * np.sqrt(np.pi) * distance * wofz(distance)
        return np.conj(plane + (1.0 - plane) * boundary_loss)


def miki_impedance(frequency_hz: NDArray, flow_resistivity: float) -> NDArray:
    """Impedance (F,) of a porous ground relative to that of air (Miki 1990), for the convention exp(-i omega t).

    Parameters:
        frequency_hz (Hz, (F,)): frequencies.
        flow_resistivity (Pa s/m^2): effective flow resistivity.
    """
    ratio = np.maximum(frequency_hz, 1e-3) / flow_resistivity
    return 1.0 + 0.070 * ratio ** -0.632 + 0.107j * ratio ** -0.632
