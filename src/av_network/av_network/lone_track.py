"""A rig's track as a target of its own: the hypothesis with which membership in a common target is compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap
from av_network.motion_model import nearly_constant_velocity
from av_network.observation import Observation
from av_network.settings import NetworkSettings


class LoneTrack(NamedTuple):
    """Nearly constant angular velocity, with the speed and the manoeuvres that the network's targets have at a distance.

    Models of different manoeuvres would by themselves speak for one hypothesis, and that the longer, the more.

    Parameters:
        time (s): by the rig's clock.
        angles (2,) (rad), rates (2,) (rad/s): of azimuth and elevation.
        covariance (2, 2, 2): of the angle and the rate of each axis.
        density (rad^2/s^3): of the angular acceleration.
    """

    time: float
    angles: NDArray[np.float64]
    rates: NDArray[np.float64]
    covariance: NDArray[np.float64]
    density: float


def begin(one: Observation, distance: float, settings: NetworkSettings) -> LoneTrack:
    """A track with its first observation.

    Parameters:
        one: the observation.
        distance (m): at which its target is supposed.
        settings: speed and manoeuvres of targets.
    """
    rate = (settings.speed_sigma / distance) ** 2
    P = np.array([np.diag([variance, rate]) for variance in np.diag(one.covariance)])
    return LoneTrack(one.time, one.angles, np.zeros(2), P, settings.manoeuvre / distance**2)


def follow(tracks: Sequence[LoneTrack], observations: Sequence[Observation]) -> tuple[list[LoneTrack], NDArray[np.float64]]:
    """Use the next observation of each of k tracks; returns the tracks and the logarithms (k,) of the densities (1/sr).

    Parameters:
        tracks (k,): by their earlier observations.
        observations (k,): one of each.
    """
    if not tracks:
        return [], np.zeros(0)
    steps = np.array([one.time - each.time for one, each in zip(observations, tracks, strict=True)])
    angles, rates, P = (np.array([getattr(each, name) for each in tracks]) for name in ('angles', 'rates', 'covariance'))
    parts = [nearly_constant_velocity(step, each.density) for step, each in zip(steps, tracks, strict=True)]
    F, Q = (np.array([part[which] for part in parts])[:, None] for which in (0, 1))
    P = F @ P @ F.transpose(0, 1, 3, 2) + Q
    angles = angles + steps[:, None] * rates
    measured = np.array([one.angles for one in observations])
    scale = np.stack([np.maximum(np.cos(measured[:, 1]), 0.1), np.ones(len(tracks))], 1)
    residuals = wrap(measured - angles) * scale
    S = P[..., 0, 0] + np.array([np.diag(one.covariance) for one in observations])
    gain = P[..., :, 0] / S[..., None]
    angles, rates = angles + gain[..., 0] * residuals / scale, rates + gain[..., 1] * residuals / scale
    P = P - gain[..., :, None] * gain[..., None, :] * S[..., None, None]
    density = -0.5 * np.sum(residuals**2 / S + np.log(S), axis=1) - math.log(math.tau)
    moved = [LoneTrack(one.time, angles[k], rates[k], P[k], each.density)
             for k, (one, each) in enumerate(zip(observations, tracks, strict=True))]
    return moved, density


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
    known = [(each, one) for each, one in zip(tracks, observations, strict=True) if each is not None and not one.anew]
    followed = iter(zip(*follow([each for each, _ in known], [one for _, one in known]), strict=True))
    found: list[tuple[LoneTrack, float]] = []
    for each, one, place in zip(tracks, observations, places, strict=True):
        if each is not None and not one.anew:
            track, logarithm = next(followed)
            found.append((track, float(logarithm)))
        else:
            found.append((begin(one, max(float(np.linalg.norm(place - one.position)), 1.0), settings), math.log(density)))
    return found
