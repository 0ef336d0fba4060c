"""The simulator's visual oracle without rendered images: occlusion is found by rays, a hundred times faster."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from av_common.camera import PinholeCamera
from av_sim_bridge.wire.oracle import OracleBox
from av_simulator.rendering.camera_effects import FOG_SHARE
from av_simulator.rendering.scenes import Solid
from av_simulator.rendering.view import Appearance, Box, Drone, TruthBox, View, appearance, outline, reported, rotor_hubs, score

Visible = tuple[Box, float] | None  # box (px) of what is visible of a drone, and the share (0 to 1) of that; None of nothing


class Oracle:
    """Boxes of the drones in a view, with the score and the occlusion of the simulator's oracle.

    Parameters:
        camera: intrinsics.
        solids: that occlude.
        thermal: whether the camera sees heat, which needs no light.
    """

    def __init__(self, camera: PinholeCamera, solids: Sequence[Solid], thermal: bool = False) -> None:
        self._camera, self._solids, self._thermal = camera, Solids(solids), thermal

    def boxes(self, view: View) -> list[OracleBox]:
        """Boxes of the visible drones in a view."""
        return reported(self.look(view, drone) for drone in view.drones)

    def look(self, view: View, drone: Drone, visible: Callable[[Appearance], Visible] | None = None) -> TruthBox:
        """How a drone appears in a view.

        Parameters:
            view: pose of the camera, air and light.
            drone: the drone.
            visible: gives what is visible of it in a rendered image; without one, that of points on it.
        """
        transmission = view.atmosphere.transmission(view.position, drone.position)
        seen = appearance(self._camera, view, drone)
        shown = None if seen is None else (visible or partial(self._visible, view, drone))(seen)
        if seen is None or shown is None:
            return TruthBox(drone.target_id, None, 0.0, transmission)
        box, share = shown
        if self._thermal:    # more of the heat passes the air than of the light
            left = max(transmission, 1e-9) ** (FOG_SHARE - 1.0)
        else:                # an image that is too dark or overexposed has less contrast
            light = view.daylight * view.exposure
            left = min(1.0, light / 0.3, (2.0 / light) ** 2 if light > 2.0 else 1.0)
        value = score(seen.width_px, transmission * left, share * seen.in_view)
        return TruthBox(drone.target_id, box, share, transmission, value)

    def _visible(self, view: View, drone: Drone, seen: Appearance) -> Visible:
        points = np.concatenate([drone.position[np.newaxis], rotor_hubs(drone), outline(drone)])
        points = np.concatenate([points, 0.5 * (points[1:] + drone.position)])
        hidden = self._solids.hide(view.position, points)
        if hidden.all():
            return None
        pixels = self._camera.project(view.to_optical(points[~hidden]))
        low, high = (np.clip(edge, seen.box[:2], seen.box[2:]) for edge in (pixels.min(axis=0), pixels.max(axis=0)))
        return (float(low[0]), float(low[1]), float(high[0]), float(high[1])), 1.0 - float(hidden.mean())


class Solids:
    """Solids for the occlusion of lines of sight. In its own frame and scale a solid is [-1, 1]^3, cut by a quadric.

    Parameters:
        solids: boxes, cylinders, ellipsoids and cones in the world.
    """

    def __init__(self, solids: Sequence[Solid]) -> None:
        yaw = np.array([solid.yaw for solid in solids])
        zero, one = np.zeros_like(yaw), np.ones_like(yaw)
        turn = np.array([[np.cos(yaw), np.sin(yaw), zero], [-np.sin(yaw), np.cos(yaw), zero], [zero, zero, one]])
        half = np.array([solid.half_size for solid in solids]).reshape(-1, 3)
        self._centres = np.array([solid.centre for solid in solids]).reshape(-1, 3)
        self._to_cube = turn.transpose(2, 0, 1) / half[:, :, np.newaxis]  # (s, 3, 3)
        # Inside where x^2 + y^2 + a z^2 + b z <= c; boxes have no quadric.
        shapes = {'box': (0.0, 0.0, np.inf), 'cylinder': (0.0, 0.0, 1.0), 'ellipsoid': (1.0, 0.0, 1.0),
                  'cone': (-0.25, 0.5, 0.25)}
        self._quadric = np.array([shapes[solid.shape] for solid in solids]).reshape(-1, 3)

    def hide(self, eye: NDArray, points: NDArray) -> NDArray[np.bool_]:
        """Whether each point (n,) is hidden.

        Parameters:
            eye (3, m): viewpoint in the world.
            points (n, 3, m): in the world.
        """
        start = np.einsum('sij,sj->si', self._to_cube, eye - self._centres)[:, np.newaxis]
        ray = np.einsum('sij,nj->sni', self._to_cube, points - eye)
        with np.errstate(divide='ignore', invalid='ignore'):
            one, other = (-1.0 - start) / ray, (1.0 - start) / ray
        enter = np.fmin(one, other).max(axis=2).clip(min=0.0)
        leave = np.fmax(one, other).min(axis=2).clip(max=1.0)
        a, b, c = self._quadric.T[:, :, np.newaxis]
        square = ray[..., 0] ** 2 + ray[..., 1] ** 2 + a * ray[..., 2] ** 2
        linear = 2.0 * (start * ray)[..., :2].sum(axis=2) + (2.0 * a * start[..., 2] + b) * ray[..., 2]
        constant = start[..., 0] ** 2 + start[..., 1] ** 2 + a * start[..., 2] ** 2 + b * start[..., 2]
        with np.errstate(divide='ignore', invalid='ignore'):  # rays that miss
            lowest = np.where(square > 0.0, -0.5 * linear / square, enter).clip(enter, np.maximum(enter, leave))
            inside = np.min([square * t**2 + linear * t + constant for t in (enter, lowest, leave)], axis=0) <= c
        return ((enter < leave) & inside).any(axis=0)
