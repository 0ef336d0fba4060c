"""Images of flat shapes drawn with OpenCV, for machines without OpenGL: sky, ground, solids and drones in uniform fog."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from av_common.camera import PinholeCamera
from av_simulator.rendering.camera_effects import AIRLIGHT, SKY_DISTANCE, CameraEffects
from av_simulator.rendering.oracle import Oracle
from av_simulator.rendering.scenes import Scene, Solid
from av_simulator.rendering.view import Drone, RenderedImage, View, rotor_hubs

# Colours are blue, green, red from 0 to 255.
_ZENITH, _HORIZON = np.array([200.0, 160.0, 110.0], np.float32), np.array([225.0, 215.0, 205.0], np.float32)
_GROUND = np.array([60.0, 95.0, 85.0], np.float32)
_DRONE, _ROTOR = np.array([40.0, 38.0, 36.0]), np.array([70.0, 68.0, 66.0])
_COARSE = 2            # sky and ground are smooth and therefore drawn at half the resolution
_NEAREST = 0.1         # m, depth below which nothing is drawn
_SUBPIXEL = 4          # fractional bits of OpenCV's coordinates
_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


class FlatRenderer:
    """Renderer of flat shapes for one camera and one scene. The same seed and view give the same image.

    Parameters:
        camera: pinhole model of the camera.
        scene: solids, ground and sky.
        seed: seed of scene and noise.
        obstacles: solids in addition to those of the scene.
        thermal: whether the oracle's camera sees heat; the images are those of light.
    """

    def __init__(self, camera: PinholeCamera, scene: Scene, seed: int, obstacles: Sequence[Solid] = (), thermal: bool = False):
        self._camera = camera
        width, height = camera.width // _COARSE, camera.height // _COARSE
        columns, rows = np.meshgrid(np.arange(width), np.arange(height))
        rays = camera.scaled(width, height).rays(np.column_stack([columns.ravel(), rows.ravel()]))
        self._rays = rays.astype(np.float32).reshape(height, width, 3)
        self._solids = [*scene.solids(np.random.default_rng([seed, 11])), *obstacles]
        self._oracle = Oracle(camera, self._solids, thermal)
        self._corners = np.array([_corners(solid) for solid in self._solids]).reshape(-1, len(_CORNERS), 3)
        self._effects = CameraEffects(camera.width, camera.height, seed)

    def render(self, view: View) -> RenderedImage:
        """The image of one view, with the oracle's boxes."""
        bgr = self._background(view)
        optical = view.to_optical(self._corners)
        pixels = self._camera.project(optical).reshape(*optical.shape[:2], 2)
        inside = ((pixels.max(axis=1) > 0.0) & (pixels.min(axis=1) < (self._camera.width, self._camera.height))).all(axis=1)
        inside &= optical[..., 2].min(axis=1) > _NEAREST
        distances = np.linalg.norm(optical.mean(axis=1), axis=1)
        things: list[tuple[float, int | Drone]] = [(float(distances[n]), int(n)) for n in np.flatnonzero(inside)]
        things += [(float(np.linalg.norm(drone.position - view.position)), drone) for drone in view.drones]
        for distance, thing in sorted(things, key=lambda item: -item[0]):
            clear = float(np.exp(-view.atmosphere.fog * distance))
            if isinstance(thing, Drone):
                self._draw_drone(bgr, view, thing, _fogged(_DRONE, clear), _fogged(_ROTOR, clear))
            else:
                solid = self._solids[thing]
                _draw_solid(bgr, solid.shape, pixels[thing], _fogged(255.0 * np.array(solid.colour[::-1]), clear))
        return RenderedImage(self._effects.apply(bgr, view), [self._oracle.look(view, drone) for drone in view.drones])

    def close(self) -> None:
        """Do nothing: this renderer holds no resources."""

    def _background(self, view: View) -> NDArray:
        upward = self._rays @ view.rotation[2].astype(np.float32)
        sky = upward > -1e-3
        distance = np.where(sky, np.float32(SKY_DISTANCE), np.float32(view.position[2]) / np.maximum(-upward, 1e-3))
        clear = np.exp(-np.float32(view.atmosphere.fog) * distance)[..., np.newaxis]
        above = _HORIZON + (_ZENITH - _HORIZON) * np.clip(2.0 * upward, 0.0, 1.0)[..., np.newaxis]
        seen = AIRLIGHT + clear * (np.where(sky[..., np.newaxis], above, _GROUND) - AIRLIGHT)
        size = self._camera.width, self._camera.height
        return cv2.resize(seen.clip(0, 255).astype(np.uint8), size, interpolation=cv2.INTER_LINEAR)

    def _draw_drone(self, image: NDArray, view: View, drone: Drone, colour: tuple[float, ...],
                    rotor_colour: tuple[float, ...]) -> None:
        optical = view.to_optical(np.concatenate([drone.position[np.newaxis], rotor_hubs(drone)]))
        body, *hubs = self._camera.project(optical)
        if (optical[:, 2] < _NEAREST).any() or not np.isfinite([body, *hubs]).all():
            return
        scale = self._camera.fx * drone.size / optical[0, 2]
        # The aspect ratio of a rotor's disc is the cosine of the angle between its axis and the line of sight.
        flat = abs(float(drone.rotation[:, 2] @ (drone.position - view.position)))
        flat /= float(np.linalg.norm(drone.position - view.position))
        for hub in hubs:
            cv2.line(image, _fixed(body), _fixed(hub), colour, max(int(0.05 * scale), 1), cv2.LINE_AA, _SUBPIXEL)
            axes = _fixed([0.15 * scale, max(0.15 * scale * flat, 0.6)])
            cv2.ellipse(image, _fixed(hub), axes, 0, 0, 360, rotor_colour, -1, cv2.LINE_AA, _SUBPIXEL)
        axes = _fixed([max(0.16 * scale, 0.7), max(0.10 * scale, 0.6)])
        cv2.ellipse(image, _fixed(body), axes, 0, 0, 360, colour, -1, cv2.LINE_AA, _SUBPIXEL)


def _corners(solid: Solid) -> NDArray:
    """Corners (m, (8, 3)) in ENU of the box around a solid."""
    c, s = np.cos(solid.yaw), np.sin(solid.yaw)
    return _CORNERS * solid.half_size @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + solid.centre


def _draw_solid(image: NDArray, shape: str, pixels: NDArray, colour: tuple[float, ...]) -> None:
    """Draw the outline of a solid's box (px, (8, 2)); for ellipsoids and cones, an ellipse or a triangle of that size."""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    middle = (low + high) / 2
    if shape == 'ellipsoid':
        cv2.ellipse(image, _fixed(middle), _fixed((high - low) / 2), 0, 0, 360, colour, -1, cv2.LINE_AA, _SUBPIXEL)
        return
    if shape == 'cone':
        pixels = np.array([[low[0], high[1]], [high[0], high[1]], [middle[0], low[1]]])
    hull = cv2.convexHull(np.array([_fixed(pixel) for pixel in pixels], np.int32))
    cv2.fillConvexPoly(image, hull, colour, cv2.LINE_AA, _SUBPIXEL)


def _fogged(colour: NDArray, clear: float) -> tuple[float, ...]:
    """A colour behind fog of the transmission `clear`."""
    return tuple(float(value) for value in AIRLIGHT + clear * (colour - AIRLIGHT))


def _fixed(values: NDArray | list[float]) -> tuple[int, ...]:
    """Pixels as OpenCV's fixed-point integers, limited to their range."""
    return tuple(int(np.clip(value, -2e4, 2e4) * (1 << _SUBPIXEL)) for value in values)
