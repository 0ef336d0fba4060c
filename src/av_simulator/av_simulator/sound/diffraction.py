"""Loss of sound behind edges (Kurze and Anderson, Sound attenuation by barriers, 1971; after Maekawa 1968)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from av_simulator.sound.obstacles import Obstacle, detours

_MOST_LOSS_DB = 25.0  # maximum loss, limited by scattering (ISO 9613-2:1996, 7.4)
_COHERENT_M = 0.5  # m, difference of path lengths over which turbulence destroys the coherence of two waves
_CLEAR_NUMBER = -0.2  # Fresnel number below which an edge has no effect


def edge_loss_db(detour_m: NDArray, frequency_hz: NDArray, speed_of_sound: float) -> NDArray:
    """Loss (dB, (paths, F)) of diffraction at edges.

    Parameters:
        detour_m (m, (paths,)): extra length of the path over each edge; negative for a free line of sight.
        frequency_hz (Hz, (F,)): frequencies.
        speed_of_sound (m/s): speed of sound.
    """
    fresnel = 2.0 * detour_m[:, None] * frequency_hz / speed_of_sound
    root = np.sqrt(2.0 * np.pi * np.abs(fresnel)) + 1e-9
    bend = np.where(fresnel < 0.0, np.tan(np.minimum(root, 1.5)), np.tanh(root))
    loss = 5.0 + 20.0 * np.log10(root / bend)
    return np.where(fresnel < _CLEAR_NUMBER, 0.0, np.maximum(loss, 0.0))


def occlusion(obstacles: Iterable[Obstacle], source: NDArray, receiver: NDArray, frequency_hz: NDArray,
              speed_of_sound: float) -> NDArray:
    """Amplitude factor (F,) of all obstacles between source and receiver.

    Paths of similar length around one obstacle are added coherently, so that a trunk thinner than the wavelength casts no
    shadow; others are added by energy. The losses (dB) of several obstacles are added.

    Parameters:
        obstacles: obstacles to consider.
        source, receiver (m, (3,)): positions in ENU.
        frequency_hz (Hz, (F,)): frequencies.
        speed_of_sound (m/s): speed of sound.
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
