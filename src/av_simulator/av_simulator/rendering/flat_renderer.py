"""Images of flat shapes drawn with OpenCV, for machines without OpenGL: sky, ground, solids and drones in uniform fog."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from av_common.camera import PinholeCamera
from av_simulator.rendering.camera_effects import AIRLIGHT
from av_simulator.rendering.oracle import Oracle
from av_simulator.rendering.scenes import Scene, Solid
from av_simulator.rendering.view import Drone, RenderedImage, View, rotor_hubs

# Colours are blue, green, red from 0 to 255.
_ZENITH, _HORIZON = np.array([200.0, 160.0, 110.0]), np.array([225.0, 215.0, 205.0])
_GROUND = np.array([60.0, 95.0, 85.0])  # blue, green, red
_DRONE, _ROTOR = np.array([40.0, 38.0, 36.0]), np.array([70.0, 68.0, 66.0])
_SKY_DISTANCE = 1500.0  # m, length of the path through fog to the sky
_COARSE = 2            # sky and ground are smooth and therefore drawn at half the resolution
_NOISE = 2.5           # grey levels, standard deviation of the sensor noise
_NOISES = 8            # number of noise images, which are used in turn
_SUBPIXEL = 4          # fractional bits of OpenCV's coordinates
_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


class FlatRenderer:
    """Renderer of flat shapes for one camera and one scene. The same seed and view give the same image.

    Parameters:
        camera: pinhole model of the camera.
        scene: solids, ground and sky.
        seed: seed of scene, texture and noise.
        obstacles: solids in addition to those of the scene.
        thermal: whether the oracle's camera sees heat; the images are those of light.
    """

    def __init__(self, camera: PinholeCamera, scene: Scene, seed: int, obstacles: Sequence[Solid] = (), thermal: bool = False):
        self._camera = camera
        random = np.random.default_rng([seed, 11])
        width, height = camera.width // _COARSE, camera.height // _COARSE
        columns, rows = np.meshgrid(np.arange(width), np.arange(height))
        pixels = np.column_stack([columns.ravel(), rows.ravel()])
        self._rays = camera.scaled(width, height).rays(pixels).astype(np.float32)
        self._shape = (height, width)
        self._texture = gaussian_filter(random.normal(0.0, 30.0, (256, 256)), 1.5, mode='wrap').astype(np.float32)
        self._noise = np.clip(random.normal(128.0, _NOISE, (_NOISES, camera.height, camera.width, 1)), 0, 255) \
            .astype(np.uint8).repeat(3, axis=3)
        self._solids = [*scene.solids(np.random.default_rng([seed, 11])), *obstacles]
        self._oracle = Oracle(camera, self._solids, thermal)
        self._places = np.array([solid.centre for solid in self._solids]).reshape(-1, 3)

    def render(self, view: View) -> RenderedImage:
        """The image of one view, with the oracle's boxes."""
        bgr = self._background(view)
        solids = self._visible(view)
        drones = [(float(np.linalg.norm(drone.position - view.position)), drone) for drone in view.drones]
        things: list[tuple[float, Solid | Drone]] = [*solids, *drones]
        for distance, thing in sorted(things, key=lambda item: -item[0]):
            clear = float(np.exp(-view.atmosphere.fog * distance))
            if isinstance(thing, Drone):
                self._draw_drone(bgr, view, thing, _fogged(_DRONE, clear), _fogged(_ROTOR, clear))
            else:
                self._draw_solid(bgr, view, thing, _fogged(255.0 * np.array(thing.colour[::-1]), clear))
        bgr = cv2.addWeighted(bgr, 1.0, self._noise[view.index % _NOISES], 1.0, -128.0)
        looks = [self._oracle.look(view, drone) for drone in view.drones]
        return RenderedImage(bgr, [box for _, box in looks if box is not None], [truth for truth, _ in looks])

    def close(self) -> None:
        """Do nothing: this renderer holds no resources."""

    def _background(self, view: View) -> NDArray:
        upward = self._rays @ view.rotation[2].astype(np.float32)
        sky = upward > -1e-3
        distance = np.where(sky, np.float32(_SKY_DISTANCE), np.float32(view.position[2]) / np.maximum(-upward, 1e-3))
        places = (distance[:, np.newaxis] * (self._rays @ view.rotation[:2].T.astype(np.float32))
                  + view.position[:2].astype(np.float32)) * np.float32(8.0)
        x, y = places.astype(np.int32).T & 255
        clear = np.exp(-np.float32(view.atmosphere.fog) * distance)
        grain = self._texture[y, x] * clear * np.where(sky, np.float32(0), np.float32(1))
        blue = np.clip(upward * 2.0, 0.0, 1.0)
        image = np.empty((len(upward), 3), np.float32)
        for channel in range(3):
            above = _HORIZON[channel] + (_ZENITH - _HORIZON)[channel] * blue
            surface = np.where(sky, above, _GROUND[channel])
            image[:, channel] = AIRLIGHT[channel] + clear * (surface - AIRLIGHT[channel]) + grain
        coarse = np.clip(image, 0, 255).astype(np.uint8).reshape(*self._shape, 3)
        return cv2.resize(coarse, (self._camera.width, self._camera.height), interpolation=cv2.INTER_LINEAR)

    def _visible(self, view: View) -> list[tuple[float, Solid]]:
        depth = view.to_optical(self._places)[:, 2]
        distance = np.linalg.norm(self._places - view.position, axis=1)
        return [(float(distance[n]), self._solids[n]) for n in np.flatnonzero(depth > 0.5 * distance)]

    def _draw_solid(self, image: NDArray, view: View, solid: Solid, colour: tuple[float, ...]) -> None:
        """Draw the outline of a solid's box; for ellipsoids and cones, an ellipse or a triangle of that size."""
        c, s = np.cos(solid.yaw), np.sin(solid.yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        corners = view.to_optical(_CORNERS * solid.half_size @ turn.T + solid.centre)
        if (corners[:, 2] < 0.1).any():
            return
        pixels = self._camera.project(corners)
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        middle = (low + high) / 2
        if solid.shape == 'ellipsoid':
            cv2.ellipse(image, _fixed(middle), _fixed((high - low) / 2), 0, 0, 360, colour, -1, cv2.LINE_AA, _SUBPIXEL)
            return
        if solid.shape == 'cone':
            pixels = np.array([[low[0], high[1]], [high[0], high[1]], [middle[0], low[1]]])
        hull = cv2.convexHull(np.array([_fixed(pixel) for pixel in pixels], np.int32))
        cv2.fillConvexPoly(image, hull, colour, cv2.LINE_AA, _SUBPIXEL)

    def _draw_drone(self, image: NDArray, view: View, drone: Drone, colour: tuple[float, ...],
                    rotor_colour: tuple[float, ...]) -> None:
        optical = view.to_optical(np.concatenate([drone.position[np.newaxis], rotor_hubs(drone)]))
        if (optical[:, 2] < 0.1).any():
            return
        body, *hubs = self._camera.project(optical)
        scale = self._camera.fx * drone.size / optical[0, 2]
        if not (-scale < body[0] < self._camera.width + scale and -scale < body[1] < self._camera.height + scale):
            return
        # The aspect ratio of a rotor's disc is the cosine of the angle between its axis and the line of sight.
        flat = abs(float(drone.rotation[:, 2] @ (drone.position - view.position)))
        flat /= float(np.linalg.norm(drone.position - view.position))
        for hub in hubs:
            cv2.line(image, _fixed(body), _fixed(hub), colour, max(int(0.05 * scale), 1), cv2.LINE_AA, _SUBPIXEL)
            axes = _fixed([0.15 * scale, max(0.15 * scale * flat, 0.6)])
            cv2.ellipse(image, _fixed(hub), axes, 0, 0, 360, rotor_colour, -1, cv2.LINE_AA, _SUBPIXEL)
        axes = _fixed([max(0.16 * scale, 0.7), max(0.10 * scale, 0.6)])
        cv2.ellipse(image, _fixed(body), axes, 0, 0, 360, colour, -1, cv2.LINE_AA, _SUBPIXEL)


def _fogged(colour: NDArray, clear: float) -> tuple[float, ...]:
    """A colour behind fog of the transmission `clear`."""
    clear = min(float(clear), 1.0)
    return tuple(float(value) for value in AIRLIGHT + clear * (colour - AIRLIGHT))


def _fixed(values: NDArray | list[float]) -> tuple[int, ...]:
    """Pixels as OpenCV's fixed-point integers, limited to their range."""
    return tuple(int(np.clip(value, -2e4, 2e4) * (1 << _SUBPIXEL)) for value in values)
