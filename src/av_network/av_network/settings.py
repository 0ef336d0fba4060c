"""Settings of the tracker of a network of rigs, and the datum of its coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.geodesy import geodetic_to_enu


@dataclass(frozen=True)
class RigSettings:
    """What is known beforehand of a rig.

    Parameters:
        name: its namespace, without slashes.
        heading_sigma (rad): standard deviation of the heading that the rig believes.
        clock_sigma (s): standard deviation of its clock's offset from the reference clock; 0 for the rig with that clock.
        position_sigma (m): standard deviation of its position along each axis.
    """

    name: str
    heading_sigma: float = math.radians(3.0)
    clock_sigma: float = 0.05
    position_sigma: float = 0.1


class Mode(NamedTuple):
    """Accelerations of a way to fly.

    Parameters:
        sigma (m/s^2): standard deviation.
        time (s): in which an acceleration falls to 1 / e of itself.
        duration (s): mean, of flying so.
    """

    sigma: float
    time: float
    duration: float


# Fitted to simulated smooth flights of up to 10 m/s and 3 m/s^2, as `ros2 run av_evaluation network bound` has them.
STEADY = Mode(0.8, 1.5, 8.0)
# Multirotors accelerate by up to A = 6 m/s^2, and turn back within a second. By Singer (1970) the variance of an acceleration
# that is uniform up to A, but +-A with probabilities of 0.1 each and none with 0.2, is A^2 / 3 (1 + 4 * 0.1 - 0.2).
MANOEUVRE = Mode(3.8, 0.6, 1.5)


@dataclass(frozen=True)
class NetworkSettings:
    """Settings of a `NetworkTracker`.

    Parameters:
        modes: of flight, steady first: the acceleration along each horizontal axis.
        speed_sigma (m/s): prior standard deviation of a target's velocity along each horizontal axis.
        climb_share: standard deviations of vertical velocities and accelerations over those of horizontal ones.
        velocity_memory (s): time in which a small velocity falls to 1 / e of itself, unless it is measured anew.
        memory_speed (m/s): speed from which on that time grows, with the square of the speed.
        most_distance (m): greatest distance of a target from a rig.
        heading_drift (rad/sqrt(s)), clock_drift (s/sqrt(s)): random walks of the rigs' headings and clock offsets.
        sound_speed (m/s): speed of sound.
        target_density (1/sr): expected number of targets in a solid angle of a rig's sky that are not tracked yet.
        confirmed: probability of existence from which a candidate becomes a track.
        least_age (s): for which a candidate is observed before.
        coast (s): time after which a track without reports has lost half of its probability of existence.
        reported_error (m): root mean square error of a position, by its covariance, up to which it is reported as one.
        reported_share: of the distance from the nearest rig, up to which that error may grow.
        most_sigma (m): standard deviation of a position, the largest of any axis, at which a track ends.
        most_candidates: number of candidates that are examined at a time.
    """

    modes: tuple[Mode, ...] = (STEADY, MANOEUVRE)
    speed_sigma: float = 8.0
    climb_share: float = 0.3
    velocity_memory: float = 8.0
    memory_speed: float = 10.0
    most_distance: float = 400.0
    heading_drift: float = math.radians(0.01)
    clock_drift: float = 1e-4
    sound_speed: float = 343.2
    target_density: float = 0.4
    confirmed: float = 0.95
    least_age: float = 1.0
    coast: float = 8.0
    reported_error: float = 7.0
    reported_share: float = 0.1
    most_sigma: float = 15.0
    most_candidates: int = 40


class Datum(NamedTuple):
    """The origin of a tangent plane: latitude, longitude (deg), altitude above the ellipsoid (m); NaN where there is none."""

    latitude: float = math.nan
    longitude: float = math.nan
    altitude: float = math.nan

    @property
    def known(self) -> bool:
        """Whether there is one."""
        return all(math.isfinite(value) for value in self)


def to_enu(place: Datum, origin: Datum) -> NDArray[np.float64]:
    """East, north and up (3,) (m) of a place in the tangent plane at an origin.

    Parameters:
        place: latitude, longitude and altitude.
        origin: of the plane.

    Raises ValueError for coordinates that are not on the globe.
    """
    for each in (place, origin):
        if not (each.known and abs(each.latitude) <= 90.0 and abs(each.longitude) <= 180.0 and abs(each.altitude) < 1e5):
            raise ValueError(f'{tuple(each)} is no latitude, longitude (deg) and altitude (m)')
    return geodetic_to_enu(place, origin)
