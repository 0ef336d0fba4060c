"""A rig's track as a target of its own: the hypothesis with which membership in a common target is compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_network import motion_model, sphere
from av_network.motion_model import axis_motion, mixed, mixing, usual_modes
from av_network.observation import Observation


class LoneTrack(NamedTuple):
    """A direction that moves with the speed and the manoeuvres that the network's targets have at a distance.

    Models of different manoeuvres would by themselves speak for one hypothesis, and that the longer, the more.

    Parameters:
        time (s): by the rig's clock.
        angles (2,) (rad): azimuth and elevation of a direction close to it.
        state (f, 2, 3): arc from there (rad), its rate, and the change of that, across and up, in each mode of flight.
        covariance (f, 2, 3, 3): of the same.
        modes (f,): probabilities of the modes.
    """

    time: float
    angles: NDArray[np.float64]
    state: NDArray[np.float64]
    covariance: NDArray[np.float64]
    modes: NDArray[np.float64]


def begin(one: Observation, distance: float) -> LoneTrack:
    """A track with its first observation.

    Parameters:
        one: the observation.
        distance (m): at which its target is supposed.
    """
    shares, flights = _shares(one.angles[1]) / distance**2, len(motion_model.MODES)
    covariance = np.zeros((flights, 2, 3, 3))
    covariance[..., 0, 0], covariance[..., 1, 1] = np.diag(one.covariance), motion_model.SPEED_SIGMA**2 * shares
    covariance[..., 2, 2] = np.outer([mode.sigma**2 for mode in motion_model.MODES], shares)
    return LoneTrack(one.time, one.angles, np.zeros((flights, 2, 3)), covariance, usual_modes())


def follow(tracks: Sequence[LoneTrack], observations: Sequence[Observation], distances: NDArray[np.float64]
           ) -> tuple[list[LoneTrack], NDArray[np.float64]]:
    """Use the next observation of each of k tracks; returns the tracks and the logarithms (k,) of the densities (1/sr).

    Parameters:
        tracks (k,): by their earlier observations.
        observations (k,): one of each.
        distances (k,) (m): at which their targets are supposed.
    """
    steps = np.array([one.time - each.time for one, each in zip(observations, tracks, strict=True)])
    angles, state, P, modes = (np.array(part) for part in list(zip(*tracks, strict=True))[1:])
    modes, mix = mixing(modes, steps)
    for axis in (0, 1):
        state[:, :, axis], P[:, :, axis] = mixed(mix, state[:, :, axis], P[:, :, axis])
    F, Q = (part[:, :, None] for part in axis_motion(steps))
    shares = _shares(angles[:, 1]) / distances[:, None] ** 2
    P = F @ P @ F.swapaxes(-1, -2) + shares[:, None, :, None, None] * Q
    state = np.einsum('kfaij,kfaj->kfai', np.broadcast_to(F, P.shape), state)
    centre = np.einsum('kf,kfa->ka', modes, state[..., 0])
    ahead = sphere.moved(angles, centre)
    state[..., 0] -= centre[:, None]
    carried = sphere.carried(sphere.axes(angles), angles[:, None], ahead[:, None])  # near the zenith, across and up turn
    state = np.einsum('kai,kbi,kfbs->kfas', sphere.axes(ahead), carried, state)
    residuals = sphere.offsets(np.array([one.angles for one in observations]), ahead)[:, None] - state[..., 0]
    S = P[..., 0, 0] + np.array([np.diag(one.covariance) for one in observations])[:, None]
    gain = P[..., :, 0] / S[..., None]
    state = state + gain * residuals[..., None]
    P = P - gain[..., :, None] * gain[..., None, :] * S[..., None, None]
    density = np.log(modes) - 0.5 * np.sum(residuals**2 / S + np.log(S), axis=2) - math.log(math.tau)
    total = np.logaddexp.reduce(density, axis=1)
    modes = np.exp(density - total[:, None])
    return [LoneTrack(one.time, ahead[k], state[k], P[k], modes[k]) for k, one in enumerate(observations)], total


def separate(tracks: Sequence[LoneTrack | None], observations: Sequence[Observation], places: NDArray[np.float64],
             density: float) -> list[tuple[LoneTrack, float]]:
    """Observations as those of other targets: the track of each, and the logarithm of its density (1/sr).

    Parameters:
        tracks (k,): by their earlier observations; None for those that begin.
        observations (k,): one of each.
        places (k, 3) (m): of the targets that they are supposed to stem from.
        density (1/sr): of targets that are not tracked yet.
    """
    distances = np.maximum(np.linalg.norm(places - np.array([one.position for one in observations]), axis=1), 1.0)
    found = [(begin(one, distance), math.log(density)) for one, distance in zip(observations, distances, strict=True)]
    known = [k for k, each in enumerate(tracks) if each is not None]
    if known:
        followed = follow([each for each in tracks if each is not None], [observations[k] for k in known], distances[known])
        for k, track, logarithm in zip(known, *followed, strict=True):
            # Else the rig may have changed its mind about the side, or have lost its target to another one.
            if logarithm > math.log(density):
                found[k] = track, float(logarithm)
    return found


def _shares(elevation: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Variances (..., 2) of motion across and up at elevations (...) (rad), over those of the horizontal axes."""
    rise = np.sin(elevation) ** 2
    return np.stack([np.ones_like(rise), rise + motion_model.CLIMB_SHARE**2 * (1.0 - rise)], -1)
