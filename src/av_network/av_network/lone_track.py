"""A rig's track as a target of its own: the hypothesis with which membership in a common target is compared."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_network import sphere
from av_network.motion_model import acceleration_variance, axis_motion
from av_network.observation import Observation
from av_network.settings import NetworkSettings


class LoneTrack(NamedTuple):
    """A direction that moves with the speed and the manoeuvres that the network's targets have at a distance.

    Models of different manoeuvres would by themselves speak for one hypothesis, and that the longer, the more.

    Parameters:
        time (s): by the rig's clock.
        angles (2,) (rad): azimuth and elevation.
        rates (3,) (rad/s): of the direction, a vector in the world.
        changes (3,) (rad/s^2): of the rates.
        covariance (2, 3, 3): of the arc, its rate and the change of that, across and up.
    """

    time: float
    angles: NDArray[np.float64]
    rates: NDArray[np.float64]
    changes: NDArray[np.float64]
    covariance: NDArray[np.float64]


def begin(one: Observation, distance: float, settings: NetworkSettings) -> LoneTrack:
    """A track with its first observation.

    Parameters:
        one: the observation.
        distance (m): at which its target is supposed.
        settings: speed and manoeuvres of targets.
    """
    variances = np.stack([np.diag(one.covariance), *np.outer(
        [settings.speed_sigma**2, acceleration_variance(settings)], _shares(one.angles[1], settings) / distance**2)])
    return LoneTrack(one.time, one.angles, np.zeros(3), np.zeros(3), np.array([np.diag(each) for each in variances.T]))


def follow(tracks: Sequence[LoneTrack], observations: Sequence[Observation], distances: NDArray[np.float64],
           settings: NetworkSettings) -> tuple[list[LoneTrack], NDArray[np.float64]]:
    """Use the next observation of each of k tracks; returns the tracks and the logarithms (k,) of the densities (1/sr).

    Parameters:
        tracks (k,): by their earlier observations.
        observations (k,): one of each.
        distances (k,) (m): at which their targets are supposed.
        settings: speed and manoeuvres of targets.
    """
    steps = np.array([one.time - each.time for one, each in zip(observations, tracks, strict=True)])
    angles, rates, changes, P = (np.array(part) for part in list(zip(*tracks, strict=True))[1:])
    F, Q = (part[:, None] for part in axis_motion(steps, distances * np.linalg.norm(rates, axis=1), settings))
    shares = _shares(angles[:, 1], settings) / distances[:, None] ** 2
    P = F @ P @ F.transpose(0, 1, 3, 2) + shares[:, :, None, None] * Q
    motion = np.stack([rates, changes], 1)
    moved, rates, changes = (np.einsum('kj,kji->ki', F[:, 0, row, 1:], motion) for row in range(3))
    ahead = sphere.moved(angles, moved)
    residuals = sphere.offsets(np.array([one.angles for one in observations]), ahead)
    S = P[..., 0, 0] + np.array([np.diag(one.covariance) for one in observations])
    gain = P[..., :, 0] / S[..., None]
    found = sphere.moved(ahead, sphere.vectors(gain[..., 0] * residuals, ahead))
    rates, changes = (sphere.carried(sphere.carried(each, angles, ahead) + sphere.vectors(gain[..., row] * residuals, ahead),
                                     ahead, found) for row, each in ((1, rates), (2, changes)))
    P = P - gain[..., :, None] * gain[..., None, :] * S[..., None, None]
    density = -0.5 * np.sum(residuals**2 / S + np.log(S), axis=1) - math.log(math.tau)
    return [LoneTrack(one.time, found[k], rates[k], changes[k], P[k]) for k, one in enumerate(observations)], density


def separate(tracks: Sequence[LoneTrack | None], observations: Sequence[Observation], places: NDArray[np.float64],
             density: float, settings: NetworkSettings) -> list[tuple[LoneTrack, float]]:
    """Observations as those of other targets: the track of each, and the logarithm of its density (1/sr).

    Parameters:
        tracks (k,): by their earlier observations; None for those that begin.
        observations (k,): one of each.
        places (k, 3) (m): of the targets that they are supposed to stem from.
        density (1/sr): of targets that are not tracked yet.
        settings: speed and manoeuvres of targets.
    """
    distances = np.maximum(np.linalg.norm(places - np.array([one.position for one in observations]), axis=1), 1.0)
    known = [(each, one, distance) for each, one, distance in zip(tracks, observations, distances, strict=True)
             if each is not None and not one.anew]
    followed: Iterator[tuple[LoneTrack, float]] = iter(())
    if known:
        earlier, newer, away = zip(*known, strict=True)
        followed = iter(zip(*follow(earlier, newer, np.array(away), settings), strict=True))
    found: list[tuple[LoneTrack, float]] = []
    for each, one, distance in zip(tracks, observations, distances, strict=True):
        if each is not None and not one.anew:
            track, logarithm = next(followed)
            found.append((track, float(logarithm)))
        else:
            found.append((begin(one, distance, settings), math.log(density)))
    return found


def _shares(elevation: NDArray[np.float64] | float, settings: NetworkSettings) -> NDArray[np.float64]:
    """Variances (..., 2) of motion across and up at elevations (...) (rad), over those of the horizontal axes."""
    rise = np.sin(elevation) ** 2
    return np.stack([np.ones_like(rise), rise + settings.climb_share**2 * (1.0 - rise)], -1)
