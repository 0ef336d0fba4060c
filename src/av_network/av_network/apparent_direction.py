"""Directions in which moving targets are heard or seen, and their derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.acoustics import speed_of_sound
from av_common.angles import direction_to_angles
from av_network import sphere

SOUND_SPEED = speed_of_sound()  # m/s, in air of 20 degrees Celsius
LEAST_DISTANCE_M = 0.5  # nearer, no direction of a point is measured


class ApparentDirections(NamedTuple):
    """Directions of n targets at the time at which a rig receives their light or sound.

    Parameters:
        angles (n, 2) (rad): azimuth and elevation in the world (ENU).
        distance (n,) (m): from the rig to the place of emission.
        by_state (n, 2, 6): derivatives of the horizontal angle (the azimuth's times cos(elevation)) and of the vertical one by
            position and velocity.
        by_time (n, 2) (rad/s): derivatives by the time of reception.
    """

    angles: NDArray[np.float64]
    distance: NDArray[np.float64]
    by_state: NDArray[np.float64]
    by_time: NDArray[np.float64]


def apparent_directions(positions: NDArray[np.float64], velocities: NDArray[np.float64], origin: NDArray[np.float64],
                        ahead: NDArray[np.float64], speed: NDArray[np.float64]) -> ApparentDirections:
    """Directions to targets in uniform motion, each where it was when it emitted what is received.

    What is received at the time t was emitted at t - tau with speed * tau = |d - v tau|, d being the offset of the target at
    t. The root is that of a quadratic equation, and the derivatives are those of the implicit function.

    Parameters:
        positions, velocities (n, 3) (m, m/s): of the targets at a common time.
        origin (3,) or (n, 3) (m): place of the rig.
        ahead (n,) (s): time of reception after the time of the positions.
        speed (n,) (m/s): of sound, inf for light.
    """
    offsets = positions + ahead[:, None] * velocities - origin
    silent = ~np.isfinite(speed)
    sound = np.where(silent, 1.0, speed)
    along = np.einsum('ni,ni->n', offsets, velocities)
    squared = np.einsum('ni,ni->n', offsets, offsets)
    excess = np.maximum(sound**2 - np.einsum('ni,ni->n', velocities, velocities), 0.1 * sound**2)  # targets are subsonic
    delay = np.where(silent, 0.0, (np.sqrt(along**2 + excess * squared) - along) / excess)
    seen = offsets - delay[:, None] * velocities
    distance = np.maximum(np.linalg.norm(seen, axis=1), LEAST_DISTANCE_M)
    unit = seen / distance[:, None]
    slowness = np.where(silent, 0.0, 1.0 / np.maximum(sound + np.einsum('ni,ni->n', unit, velocities), 0.1 * sound))
    shift = np.eye(3) - slowness[:, None, None] * velocities[:, :, None] * unit[:, None, :]
    angles = np.stack(direction_to_angles(seen), -1)
    by_position = (sphere.axes(angles) / distance[:, None, None]) @ shift
    by_state = np.concatenate([by_position, (ahead - delay)[:, None, None] * by_position], 2)
    return ApparentDirections(angles, distance, by_state, np.einsum('nij,nj->ni', by_position, velocities))
