"""Turbulence of the wind at the rig: the continuous Dryden model at low altitude (MIL-F-8785C, 3.7; MIL-HDBK-1797, app. A)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FEET = 0.3048                 # m
LEAST_HEIGHT, MOST_HEIGHT = 10.0 * FEET, 1000.0 * FEET    # m, range of the model
MOST_SPEED = 60.0             # m/s, of the air
LEAST_AIRSPEED = 1.0          # m/s; turbulence that does not pass by would not change


def length_scales(height: float) -> tuple[float, float]:
    """Length scales (m) of horizontal and of vertical turbulence at a height (m)."""
    feet = min(max(height, LEAST_HEIGHT), MOST_HEIGHT) / FEET
    return feet / (0.177 + 0.000823 * feet) ** 1.2 * FEET, feet * FEET


def vertical_share(height: float) -> float:
    """Standard deviation of vertical turbulence relative to that of horizontal turbulence, at a height (m)."""
    feet = min(max(height, LEAST_HEIGHT), MOST_HEIGHT) / FEET
    return (0.177 + 0.000823 * feet) ** 0.4


class Gusts:
    """Wind at a body that moves through frozen turbulence: along the mean wind, across it, and vertical.

    The spectra are Dryden's: 1 / (1 + T s) along the wind and (1 + sqrt(3) T s) / (1 + T s)^2 across it and upwards, where T is
    the length scale over the airspeed.

    Parameters:
        velocity (m/s, (3,)): mean velocity in ENU.
        relative: standard deviation of horizontal turbulence relative to the mean speed.
        key: seed.
    """

    def __init__(self, velocity: Sequence[float], relative: float, key: Sequence[int]):
        self._mean = np.array(velocity, float)
        self._sigma = relative * float(np.linalg.norm(self._mean))
        along = np.array([*self._mean[:2], 0.0])
        length = float(np.linalg.norm(along))
        along = along / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
        up = np.array([0.0, 0.0, 1.0])
        self._axes = np.stack([along, np.cross(up, along), up], axis=1)
        self._random = np.random.default_rng(key)
        self._fast, self._slow = self._random.standard_normal(3), np.zeros(3)

    def step(self, dt: float, height: float, velocity: NDArray) -> NDArray:
        """Velocity (m/s, (3,)) of the air in ENU after `dt` (s).

        Parameters:
            dt (s): time since the step before.
            height (m): height of the body above ground.
            velocity (m/s, (3,)): velocity of the body.
        """
        if self._sigma == 0.0:
            return self._mean
        airspeed = max(float(np.linalg.norm(velocity - self._mean)), LEAST_AIRSPEED)
        horizontal, vertical = length_scales(height)
        kept = np.exp(-dt * airspeed / np.array([horizontal, horizontal, vertical]))
        self._fast = kept * self._fast + np.sqrt(1.0 - kept**2) * self._random.standard_normal(3)
        self._slow += (1.0 - kept) * (self._fast - self._slow)
        across = (math.sqrt(3.0) * self._fast + (1.0 - math.sqrt(3.0)) * self._slow) / math.sqrt(2.0)
        gust = self._sigma * np.array([self._fast[0], across[1], vertical_share(height) * across[2]])
        air = self._mean + self._axes @ gust
        return air * min(1.0, MOST_SPEED / max(float(np.linalg.norm(air)), 1e-9))
