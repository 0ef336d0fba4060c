"""Plans where a gimbal turns the camera while the target is heard but not seen.

A look shows the target, and with it which of its possible directions is true, or makes them less probable by not showing it.
What is best is the look that is expected to tell most for the time that it takes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from numpy.typing import NDArray

from av_common.angles import angles_to_direction, direction_to_angles
from av_common.gimbal_geometry import gimbal_to_mount
from av_common.rate_meter import MISSING_AFTER_S
from av_common.rig import GimbalMount
from av_fusion.disambiguation.rotation import REPLAN_S
from av_fusion.measurement.measurements import CameraMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import angles, heading, turned_back
from av_fusion.tracks.component import GaussianComponent

OVERHEAD_S = 0.6  # of each look beside the way: the gimbal settles, an image is taken, and the detector answers
BUDGET_S = 8.0  # for which looks are requested in a row
REST_S = 8.0  # without looks after that, and after looks told nothing; in between the body may turn
LEAST_CHANCE = 0.15  # that a look shows the target, for which it is made
EDGE = 0.93  # share of the field of view that counts: boxes at its edge are cut off
STICK = 1.3  # gain for which another look replaces one that is under way
GLANCE_S, GLANCES_KEPT_S = 0.3, 5.0  # of looking until images are independent, and how long what was looked at is remembered
MISSED = 0.1  # probability that a glance misses what is visible
# Offsets (standard deviations) and weights of the points that stand for a direction: Gauss-Hermite quadrature of a Gaussian.
OFFSETS, WEIGHTS = hermegauss(5)
BESIDE = math.radians(75.0)  # from a stop of the gimbal, up to which a wide view from there may show something

Matrix = NDArray[np.float64]


class Sight(NamedTuple):
    """What the camera saw last.

    Parameters:
        time (s): capture time of the newest image.
        camera_in_world (3, 3): rotation matrix from the camera's frame (x along the optical axis) to the world at that time.
        half_view, half_height (rad): half of the field of view.
    """

    time: float
    camera_in_world: Matrix
    half_view: float
    half_height: float


class LookPlanner:
    """Requests looks of the camera until one shows the target, or none is likely to.

    Parameters:
        gimbal: carries the camera.
    """

    def __init__(self, gimbal: GimbalMount) -> None:
        self._gimbal, self._rate = gimbal, math.radians(gimbal.max_rate_deg)
        self._limits = np.radians([gimbal.pan_limits_deg, gimbal.tilt_limits_deg])
        self._sight: Sight | None = None  # of the newest image
        self._since = self._planned = -math.inf  # first of the looks in a row, and the newest one
        self._look: Matrix | None = None  # direction in the world
        self._glances: deque[tuple[float, Sight]] = deque()  # duration and sight

    def cancel(self) -> None:
        """Forget the looks because the target is seen, or told apart."""
        self._since, self._look = -math.inf, None
        self._glances.clear()

    def on_image(self, time: float, image: CameraMeasurement, motion: RigMotion, shows_target: bool) -> None:
        """Note where the camera looked: the longer something is in view without being seen, the less visible it is.

        Parameters:
            time (s): capture time.
            image: the measurement.
            motion: of the rig.
            shows_target: whether the target was seen.
        """
        self._sight = Sight(time, np.array(motion.attitude(time)) @ np.array(image.view), image.half_view, image.half_height)
        before = self._glances[-1][1].time if self._glances else -math.inf
        if shows_target or not before < time:
            return
        self._glances.append((min(time - before, GLANCE_S), self._sight))
        while self._glances[0][1].time < time - GLANCES_KEPT_S:
            self._glances.popleft()

    def plan(self, time: float, components: Sequence[GaussianComponent], visible: float, motion: RigMotion
             ) -> tuple[float, float] | None:
        """Azimuth and elevation (rad) in the body's frame to look at; None when no look is requested.

        Parameters:
            time (s): time of the request.
            components: possible directions of the target.
            visible: probability that a camera that looks at the target for the first time finds it.
            motion: of the rig.
        """
        if abs(time - self._planned) >= REPLAN_S:
            self._replan(time, components, visible, motion)
        if self._look is None:
            return None
        x, y, z = self._look.tolist()
        return angles(turned_back(motion.attitude(time), (x, y, z)))

    def _replan(self, time: float, components: Sequence[GaussianComponent], visible: float, motion: RigMotion) -> None:
        self._planned, sight = time, self._sight
        if sight is None or abs(time - sight.time) > MISSING_AFTER_S or not components:
            self._look = None  # without a new image there is no camera to look with
            return
        if not 0.0 <= time - self._since < BUDGET_S + REST_S:
            self._since = time
        begun = time - self._since < BUDGET_S
        self._look = self._best(components, visible, sight, self._mount(time, motion)) if begun else None
        if self._look is None and begun:
            self._since = time - BUDGET_S

    def _mount(self, time: float, motion: RigMotion) -> Matrix:
        """Rotation matrix (3, 3) from the gimbal's mount to the world."""
        carrier = heading(motion.yaw(time)) if self._gimbal.stabilized else motion.attitude(time)
        return np.array(carrier) @ self._gimbal.mount.rotation

    def _best(self, components: Sequence[GaussianComponent], visibility: float, sight: Sight, mount_in_world: Matrix
              ) -> Matrix | None:
        points, shares, visible = self._points(components, visibility)
        looks = self._reachable(points @ mount_in_world)
        if self._look is not None:
            looks = np.vstack([looks, self._nearest(self._look @ mount_in_world)])
        if not len(looks):
            return None
        cameras = np.array([mount_in_world @ gimbal_to_mount(pan, tilt) for pan, tilt in looks])
        now = self._nearest(sight.camera_in_world[:, 0] @ mount_in_world)
        way = np.abs(looks - now).max(axis=1) / self._rate  # (s) both axes turn at once
        seen = np.array([in_view(points, camera, sight.half_view, sight.half_height) for camera in cameras])
        chance = seen @ (shares * visible).ravel()
        value = information(seen.reshape(len(looks), *shares.shape), shares, visible) / (way + OVERHEAD_S)
        if self._look is not None:
            value[-1] *= STICK
        value[chance < LEAST_CHANCE] = -math.inf
        best = int(np.argmax(value))
        return cameras[best][:, 0] if math.isfinite(value[best]) else None

    def _reachable(self, directions: Matrix) -> Matrix:
        """Pans and tilts (m, 2) that are closest to directions (n, 3) in the mount's frame, from either stop."""
        pan, tilt = direction_to_angles(directions)
        (left, right), (low, high) = self._limits
        turned = np.concatenate([pan, pan + math.tau, pan - math.tau])
        reached = np.stack([np.clip(turned, left, right), np.tile(np.clip(tilt, low, high), 3)], axis=1)
        return np.unique(reached[np.abs(reached[:, 0] - turned) < BESIDE], axis=0)

    def _nearest(self, direction: Matrix) -> Matrix:
        """Pan and tilt (2,) that are closest to a direction (3,) in the mount's frame."""
        reached = self._reachable(direction[None])
        off = [angles_to_direction(*each) @ direction for each in reached]
        return reached[int(np.argmax(off))] if len(reached) else np.zeros(2)

    def _points(self, components: Sequence[GaussianComponent], visibility: float) -> tuple[Matrix, Matrix, Matrix]:
        """Points (n * k, 3) that stand for n components, their probabilities (n, k), and those that they are visible (n, k).

        Fog that hides a target in one image hides it in the next: what was looked at is either elsewhere, or hidden.
        """
        points, shares, visible = [], [], []
        total = sum(component.weight for component in components)
        for component in components:
            across_sigma, up_sigma = np.sqrt(np.minimum(np.diag(component.covariance)[:2], 1.0))
            across, up = OFFSETS[1:4] * across_sigma, OFFSETS * up_sigma
            elevation = np.clip(component.elevation + up, -0.5 * math.pi, 0.5 * math.pi)[:, None]
            azimuth = component.azimuth + across[None] / np.maximum(np.cos(elevation), 0.2)
            directions = angles_to_direction(azimuth, elevation).reshape(-1, 3)
            unseen = visibility * MISSED ** (self._looked_at(directions) / GLANCE_S)
            remaining = 1.0 - visibility + unseen
            share = np.outer(WEIGHTS, WEIGHTS[1:4]).ravel() * remaining  # but for a factor
            points.append(directions)
            shares.append(component.weight / total * share / share.sum())
            visible.append(unseen / np.maximum(remaining, 1e-9))
        return np.vstack(points), np.array(shares), np.array(visible)

    def _looked_at(self, directions: Matrix) -> Matrix:
        """For how long (s) the camera had directions (n, 3) in view."""
        return sum((duration * in_view(directions, sight.camera_in_world, sight.half_view, sight.half_height)
                    for duration, sight in self._glances), np.zeros(len(directions)))


def in_view(directions: Matrix, camera: Matrix, half_view: float, half_height: float) -> Matrix:
    """Whether directions (n, 3) are within the field of view, as 0 or 1 (n,).

    Parameters:
        directions (n, 3): unit vectors.
        camera (3, 3): rotation matrix from the camera's frame (x along the optical axis) to the frame of the directions.
        half_view, half_height (rad): half of the field of view.
    """
    x, y, z = (directions @ camera).T
    wide, high = np.tan(EDGE * np.minimum((half_view, half_height), 1.5))
    return ((x > 0.0) & (np.abs(y) <= wide * x) & (np.abs(z) <= high * x)).astype(float)


def information(seen: Matrix, shares: Matrix, visible: Matrix) -> Matrix:
    """Information (nats) about the direction of the target that is expected of each of m looks, (m,).

    A look that shows the target leaves no uncertainty; one that does not, the entropy of the posterior. Within a component,
    which way the target is off its mean counts as much as in which component it is: the camera measures both.

    Parameters:
        seen (m, n, k): whether a look has a point in view, 0..1.
        shares (n, k): probabilities of the points.
        visible (n, k): probability that a point in view is seen.
    """
    missed = shares * (1.0 - visible * seen)
    chance = missed.sum(axis=(1, 2))
    return _entropy(shares[None])[0] - chance * _entropy(missed / np.maximum(chance, 1e-12)[:, None, None])


def _entropy(shares: Matrix) -> Matrix:
    """Entropy (nats, (m,)) of distributions (m, n, k)."""
    return -(shares * np.log(np.maximum(shares, 1e-12))).sum(axis=(1, 2))
