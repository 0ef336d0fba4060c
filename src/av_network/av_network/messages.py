"""Reports of messages, and messages of tracks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Vector3
from numpy.typing import NDArray

from av_common.angles import angles_to_direction
from av_common.freshness import FUTURE_S
from av_common.stamps import to_seconds, to_stamp
from av_interfaces.msg import RigReport, TargetDirection, WorldTrack
from av_network import sphere
from av_network.motion_model import SPEED_SIGMA
from av_network.network_target import TargetState
from av_network.observation import MOST_TRACKS, Observation, Report, Sighting

PUBLISHED = 0.5  # probability of existence from which a target of the network is published, and one of a rig used
OLDEST_S = 2.0  # age of a message that is used
MOST_POSITION_M = 1e6  # of a rig or target, along each axis
LONGEST_S = 1.0  # from the first direction of a report to the newest one
LEAST_SIGMA = math.radians(0.02)  # of a direction; smaller ones are not believed
LEAST_INFORMATION = 1.0 / (math.pi**2 / 3.0)  # 1/rad^2, of an angle that may be anything
MOST_INFORMATION = 1e12  # 1/rad^2; of more, the determinant is lost in rounding
ASSUMED_DISTANCE_M = 100.0  # of a target whose distance is not known, and the standard deviation of that


def check_version(rig: str, version: int) -> None:
    """Raise ValueError for a report of another version of `RigReport`."""
    if version != RigReport.VERSION:
        raise ValueError(f'{rig} reports by version {version}, expected {RigReport.VERSION}: install the same release on all '
                         'rigs')


def check_age(sender: str, late: float, uncertain: float = FUTURE_S) -> None:
    """Raise ValueError for a message of the past, or of the future.

    Parameters:
        sender: its name.
        late (s): time from the stamp to the arrival.
        uncertain (s): by which the sender's clock may be ahead.
    """
    if not -uncertain <= late <= OLDEST_S:
        raise ValueError(f'stamp of {sender} {-late:+.2f} s from its arrival, expected {-OLDEST_S} to {uncertain:+.2f} s')


def is_place(position: NDArray[np.floating[Any]]) -> bool:
    """Whether a position (3,) (m) is one, and not absurd."""
    return bool(np.all(np.abs(position) < MOST_POSITION_M))


def version_of(data: bytes) -> int:
    """The version of a serialised `RigReport`: its first field; reports from before versions have a stamp there."""
    return int.from_bytes(data[4:8], 'little' if data[1:2] == b'\x01' else 'big')


def report_of(message: RigReport, rig: str, position: NDArray[np.float64], heading: float) -> Report:
    """The report in a rig's message. Raises ValueError for more than MOST_TRACKS directions, or several of one track.

    Targets that do not probably exist, and those with impossible angles or variances, are left out.

    Parameters:
        message: the directions.
        rig: the rig's name.
        position (3,) (m): of the rig at that time, ENU.
        heading (rad): to be added to azimuths; 0 for a rig with odometry, whose heading they hold already.
    """
    if len(message.directions) > MOST_TRACKS:
        raise ValueError(f'{len(message.directions)} targets of {rig}, expected up to {MOST_TRACKS}')
    if len({one.id for one in message.directions}) < len(message.directions):
        raise ValueError(f'several directions of one target of {rig}')
    stamp = to_seconds(message.header.stamp)
    sightings = [_sighting(one, heading, stamp) for one in message.directions if one.existence >= PUBLISHED]
    return Report(rig, stamp, position, tuple(one for one in sightings if one is not None))


def _sighting(one: TargetDirection, heading: float, stamp: float) -> Sighting | None:
    horizontal, both, vertical = map(float, one.information)
    azimuth, elevation, measured = float(one.azimuth), float(one.elevation), to_seconds(one.measured)
    possible = abs(azimuth) <= 10.0 and abs(elevation) <= 0.5 * math.pi + 1e-3
    known = 0.0 <= horizontal < math.inf and 0.0 <= vertical < math.inf and horizontal + vertical > LEAST_INFORMATION
    if not possible or not known or math.isnan(both) or not 0.0 <= stamp - measured <= LONGEST_S:
        return None
    horizontal, vertical = min(horizontal, MOST_INFORMATION), min(vertical, MOST_INFORMATION)
    most = math.sqrt(horizontal * vertical)  # of a single angle, information is singular, and rounded
    both = min(max(both, -most), most)
    information = np.array([[horizontal, both], [both, vertical]]) + LEAST_INFORMATION * np.eye(2)
    covariance = np.linalg.inv(information) + LEAST_SIGMA**2 * np.eye(2)
    drone = float(one.drone_probability)
    return Sighting(one.id, math.remainder(azimuth + heading, math.tau), elevation, covariance, measured, not one.seen,
                    min(float(one.existence), 1.0), drone if 0.0 <= drone <= 1.0 else math.nan, str(one.class_id)[:32],
                    bool(one.resolved))


def target_message(state: TargetState, rigs: Sequence[str]) -> WorldTrack:
    """The message of a target, whose covariance says how far its position is known.

    Parameters:
        state: of the target.
        rigs: the rigs' names by index.
    """
    return _message(state.target.id, state.existence, state.mean, state.covariance, state.positioned,
                    [rigs[rig] for rig in state.rigs], state.target.measured,
                    drone_probability=state.target.drone_probability, class_id=state.target.class_id)


def direction_message(identifier: int, rig: str, observation: Observation, heading: float) -> WorldTrack:
    """The message of a target of a single rig, at a distance that is assumed, with a variance to match.

    Parameters:
        identifier: id of the target.
        rig: the rig's name.
        observation: the direction.
        heading (rad): correction of the rig's heading.
    """
    one = observation.sighting
    angles = np.array([one.azimuth + heading, one.elevation])
    unit, axes = angles_to_direction(*angles), sphere.axes(angles).T
    variances = np.linalg.inv(np.linalg.inv(one.covariance) + np.eye(2)) * ASSUMED_DISTANCE_M**2
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = axes @ variances @ axes.T + ASSUMED_DISTANCE_M**2 * np.outer(unit, unit)
    covariance[3:, 3:] = SPEED_SIGMA**2 * np.eye(3)
    mean = np.concatenate([observation.position + ASSUMED_DISTANCE_M * unit, np.zeros(3)])
    return _message(identifier, one.existence, mean, covariance, False, [rig], one.measured,
                    drone_probability=one.drone_probability, class_id=one.class_id)


def _message(identifier: int, existence: float, mean: NDArray[np.float64], covariance: NDArray[np.float64], positioned: bool,
             rigs: list[str], measured: float, **values: Any) -> WorldTrack:
    x, y, z, vx, vy, vz = map(float, mean)
    return WorldTrack(id=identifier, existence=existence, position=Point(x=x, y=y, z=z), velocity=Vector3(x=vx, y=vy, z=vz),
                      position_covariance=covariance[:3, :3].reshape(-1), velocity_covariance=covariance[3:, 3:].reshape(-1),
                      positioned=positioned, rigs=rigs, measured=to_stamp(max(measured, 0.0)), **values)
