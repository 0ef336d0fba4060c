"""Loss of sound behind edges (Kurze and Anderson, Sound attenuation by barriers, 1971; after Maekawa 1968)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from av_simulator.sound.obstacles import Obstacle, detours

_MOST_LOSS_DB = 25.0  # what scattering leaves of the best barriers (ISO 9613-2:1996, 7.4)
_COHERENT_M = 0.5  # difference of two ways beyond which turbulence leaves their waves no common phase
_CLEAR_NUMBER = -0.2  # Fresnel number from which an edge no longer matters


def edge_loss_db(detour_m: NDArray, frequency_hz: NDArray, speed_of_sound: float) -> NDArray:
    """Loss (ways, F) in dB over edges with a detour (ways,) in m, negative where the line of sight passes clear of the edge."""
    fresnel = 2.0 * detour_m[:, None] * frequency_hz / speed_of_sound
    root = np.sqrt(2.0 * np.pi * np.abs(fresnel)) + 1e-9
    bend = np.where(fresnel < 0.0, np.tan(np.minimum(root, 1.5)), np.tanh(root))
    loss = 5.0 + 20.0 * np.log10(root / bend)
    return np.where(fresnel < _CLEAR_NUMBER, 0.0, np.maximum(loss, 0.0))


def occlusion(obstacles: Iterable[Obstacle], source: NDArray, receiver: NDArray, frequency_hz: NDArray,
              speed_of_sound: float) -> NDArray:
    """Amplitude factor (F,) of obstacles on the way from source to receiver, each (3,) in world ENU.

    Ways around one obstacle that are about as long add as waves, so that a trunk thinner than the wavelength casts no
    shadow; others add as energies. Losses of several obstacles add in dB.
    """
    factor = np.ones(len(frequency_hz))
    for obstacle in obstacles:
        ways = detours(obstacle, source, receiver)
        if ways is not None:
            loss = edge_loss_db(ways, frequency_hz, speed_of_sound)
            apart = np.subtract.outer(*[np.maximum(ways, 0.0)] * 2)[..., None]
            together = np.exp(-(apart / _COHERENT_M) ** 2) * np.cos(2 * np.pi * apart * frequency_hz / speed_of_sound)
            amplitude = 10.0 ** (-loss / 20.0)
            energy = np.einsum('if,ijf,jf->f', amplitude, together, amplitude)
            energy[(loss == 0.0).any(axis=0)] = 1.0
            factor *= np.sqrt(np.clip(energy, 10.0 ** (-_MOST_LOSS_DB / 10.0), 1.0))
    return factor
