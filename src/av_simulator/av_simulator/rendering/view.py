"""One instant before a camera, the image made of it, and the truth about what is in it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from av_common.camera import PinholeCamera
from av_sim_bridge.wire.oracle import OracleBox
from av_simulator.rendering.atmosphere import Atmosphere
from av_simulator.rendering.visibility import score

FIRST_TARGET_ID = 2    # RFlySim numbers vehicles from 1, which is the rig
ROTOR_RADIUS = 0.15    # of a drone of size 1
BODY_SIZE = np.array([0.16, 0.09, 0.06])


@dataclass(frozen=True)
class Drone:
    """A drone in view.

    Parameters:
        target_id: the simulator's number.
        position (m, ENU): (3,).
        rotation: from its body (FLU) to ENU, (3, 3).
        size (m): from rotor tip to rotor tip.
        rotors: how many.
        turned (rad): angle of each rotor, (rotors,).
    """

    target_id: int
    position: NDArray
    rotation: NDArray
    size: float
    rotors: int = 4
    turned: NDArray = field(default_factory=lambda: np.zeros(4))


@dataclass(frozen=True)
class View:
    """What a camera images at one instant.

    Parameters:
        index: number of the image, which also seeds its noise.
        time (s): of the instant.
        position (m, ENU): of the camera, (3,).
        rotation: from the optical frame to ENU, (3, 3).
        atmosphere: the air.
        drones: in the scene.
        daylight: 1 at noon, 0.005 at night.
        exposure: gain of the image, 1 being right at noon.
        image_motion (px/s): of stationary things in the middle of the image, (2,).
    """

    index: int
    time: float
    position: NDArray
    rotation: NDArray
    atmosphere: Atmosphere = field(default_factory=Atmosphere)
    drones: list[Drone] = field(default_factory=list)
    daylight: float = 1.0
    exposure: float = 1.0
    image_motion: tuple[float, float] = (0.0, 0.0)

    def to_optical(self, points: NDArray) -> NDArray:
        """World points (n, 3) in the optical frame."""
        return (np.asarray(points) - self.position) @ self.rotation


@dataclass(frozen=True)
class TruthBox:
    """The true appearance of a target.

    Parameters:
        target_id: the simulator's number.
        box (px): min_x, min_y, max_x, max_y of its visible pixels, None where there are none.
        visible_fraction: visible pixels over those it would cover without occluders.
        transmission: share of its contrast that the air leaves.
        distance (m): from the camera.
    """

    target_id: int
    box: tuple[float, float, float, float] | None
    visible_fraction: float
    transmission: float
    distance: float


@dataclass(frozen=True)
class RenderedImage:
    """A rendered view. Layers that the renderer does not make are None.

    Parameters:
        bgr: (height, width, 3) uint8.
        boxes: the visual oracle's report.
        truth: one entry for each drone.
        depth (m): along the optical axis, inf for the sky, (height, width) float32.
        segmentation: target ids, 0 for all else, (height, width) int32.
        thermal (deg C): apparent temperature, (height, width) float32.
    """

    bgr: NDArray
    boxes: list[OracleBox]
    truth: list[TruthBox] = field(default_factory=list)
    depth: NDArray | None = None
    segmentation: NDArray | None = None
    thermal: NDArray | None = None

    @property
    def depth_mm(self) -> NDArray | None:
        """The depth as (height, width) uint16 in mm, 65535 for the sky and what is farther than 65.5 m."""
        if self.depth is None:
            return None
        return np.where(self.depth < 65.535, 1000.0 * self.depth, 65_535.0).astype(np.uint16)


class Renderer(Protocol):
    """Makes images of views."""

    def render(self, view: View) -> RenderedImage:
        """The image of one view; the same view gives the same image."""

    def close(self) -> None:
        """Give back what it holds."""


def rotor_places(count: int) -> NDArray:
    """Hubs (count, 3) of a drone of size 1 in its body's frame, alternating sides from the front left on."""
    angle = np.pi / count + 2 * np.pi * np.arange(count) / count
    radius = 0.5 - ROTOR_RADIUS
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, 0.06)])


def rotor_hubs(drone: Drone) -> NDArray:
    """Hubs (rotors, 3) of the rotors in ENU."""
    return drone.position + drone.size * rotor_places(drone.rotors) @ drone.rotation.T


def outline(drone: Drone) -> NDArray:
    """Points (n, 3) in ENU whose projections span the drone: the rims of its rotors and its feet."""
    angle = np.arange(8) * np.pi / 4
    rim = ROTOR_RADIUS * drone.size * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(8)]) @ drone.rotation.T
    feet = drone.position + drone.size * np.array([[0.1, 0.1, -0.12], [-0.1, -0.1, -0.12]]) @ drone.rotation.T
    return np.concatenate([(rotor_hubs(drone)[:, np.newaxis] + rim).reshape(-1, 3), feet])


@dataclass(frozen=True)
class Appearance:
    """Where a drone's outline falls in the image.

    Parameters:
        box (px): min_x, min_y, max_x, max_y, cut at the edges of the image.
        width_px (px): before the cut.
        in_view: share of the box inside the image.
    """

    box: tuple[float, float, float, float]
    width_px: float
    in_view: float

    def window(self, margin: int) -> tuple[slice, slice]:
        """Rows and columns of the box and `margin` pixels around it."""
        min_x, min_y, max_x, max_y = self.box
        return (slice(max(int(min_y) - margin, 0), int(max_y) + margin + 1),
                slice(max(int(min_x) - margin, 0), int(max_x) + margin + 1))


def appearance(camera: PinholeCamera, view: View, drone: Drone) -> Appearance | None:
    """Where a drone appears, None where it is out of view."""
    points = view.to_optical(outline(drone))
    # Far outside, a distortion polynomial can fold points back into the image; there the angle decides.
    if (points[:, 2] <= 0.05).any() or np.abs(np.arctan2(points[:, 0], points[:, 2])).min() > camera.horizontal_fov_rad:
        return None
    pixels = camera.project(points)
    edge = np.array([camera.width - 1.0, camera.height - 1.0])
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    inside_low, inside_high = low.clip(0.0, edge), high.clip(0.0, edge)
    in_view = float(np.prod((inside_high - inside_low) / np.maximum(high - low, 1e-9)))
    if in_view <= 0.0:
        return None
    box = (float(inside_low[0]), float(inside_low[1]), float(inside_high[0]), float(inside_high[1]))
    return Appearance(box, float(high[0] - low[0]), in_view)


def oracle_box(seen: Appearance, truth: TruthBox, light: float = 1.0) -> OracleBox | None:
    """The oracle's report of one drone in view, None where it is not credible.

    light: share of the contrast that the camera's exposure leaves.
    """
    value = score(seen.width_px, truth.transmission * light, truth.visible_fraction * seen.in_view)
    return OracleBox(truth.target_id, value, *(truth.box or seen.box)) if value > 0.0 else None
