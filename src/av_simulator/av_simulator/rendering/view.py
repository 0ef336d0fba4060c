"""Input and output of renderers: the camera's view at one instant, the image, and the true boxes of the targets."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from av_common.camera import PinholeCamera
from av_sim_bridge.wire.oracle import OracleBox
from av_simulator.rendering.atmosphere import Atmosphere

ROTOR_RADIUS = 0.15    # relative to the size of the drone
BODY_SIZE = np.array([0.16, 0.09, 0.06])    # half axes relative to the size of the drone
HALF_SIZE_PX = 8.0        # width of a target with a score of 0.5 in clear air
HALF_TRANSMISSION = 0.15  # contrast at which a large target has a score of 0.5
LEAST = 0.05              # score below which a detector reports nothing
Box = tuple[float, float, float, float]     # px, min_x, min_y, max_x, max_y


@dataclass(frozen=True)
class Drone:
    """Pose and size of a drone.

    Parameters:
        target_id: number of the vehicle in the simulator.
        position (m, (3,)): position in ENU.
        rotation ((3, 3)): rotation matrix from the body (FLU) to ENU.
        size (m): distance between opposite rotor tips.
        rotors: number of rotors.
        turned (rad, (rotors,)): angle of each rotor.
    """

    target_id: int
    position: NDArray
    rotation: NDArray
    size: float
    rotors: int = 4
    turned: NDArray = field(default_factory=lambda: np.zeros(4))


@dataclass(frozen=True)
class View:
    """The camera's view at one instant.

    Parameters:
        index: number of the image, which also seeds its noise.
        time (s): simulated time.
        position (m, (3,)): position of the camera in ENU.
        rotation ((3, 3)): rotation matrix from the optical frame to ENU.
        atmosphere: the air.
        drones: drones in the scene.
        daylight: illumination, 1 at noon, 0.005 at night.
        exposure: gain of the image; 1 is correct at noon.
        image_motion (px/s, (2,)): motion of stationary objects in the middle of the image, x and y.
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
        """Points (m, (n, 3)) in ENU, transformed to the optical frame."""
        return (np.asarray(points) - self.position) @ self.rotation


@dataclass(frozen=True)
class TruthBox:
    """The true appearance of a target.

    Parameters:
        target_id: number of the vehicle in the simulator.
        box (px): min_x, min_y, max_x, max_y of the visible pixels, None without visible pixels.
        visible_fraction (0 to 1): number of visible pixels over that without occlusion.
        transmission (0 to 1): transmission of the air between camera and target.
        score (0 to 1): of the visual oracle's report; 0 for none.
    """

    target_id: int
    box: Box | None
    visible_fraction: float
    transmission: float
    score: float = 0.0


@dataclass(frozen=True)
class RenderedImage:
    """A rendered view. Layers that the renderer does not support are None.

    Parameters:
        bgr ((height, width, 3), uint8): image; of a thermal camera (height, width), grey levels or raw counts.
        truth: true box of each drone.
        depth (m, (height, width), float32): distance along the optical axis, inf for the sky.
        segmentation ((height, width), int32): target ids, 0 for other objects.
        thermal (deg C, (height, width), float32): apparent temperature.
    """

    bgr: NDArray
    truth: list[TruthBox] = field(default_factory=list)
    depth: NDArray | None = None
    segmentation: NDArray | None = None
    thermal: NDArray | None = None

    @property
    def boxes(self) -> list[OracleBox]:
        """Report of the visual oracle."""
        return reported(self.truth)

    @property
    def depth_mm(self) -> NDArray | None:
        """Depth (mm, (height, width), uint16), 65535 for the sky and distances above 65.5 m."""
        if self.depth is None:
            return None
        return np.where(self.depth < 65.535, 1000.0 * self.depth, 65_535.0).astype(np.uint16)


def reported(truth: Iterable[TruthBox]) -> list[OracleBox]:
    """What the visual oracle reports of true boxes."""
    return [OracleBox(each.target_id, each.score, *each.box) for each in truth if each.box and each.score > 0.0]


def rotor_places(count: int) -> NDArray:
    """Positions (count, 3) of the rotor hubs in the body frame (FLU) of a drone of size 1, counter-clockwise."""
    angle = np.pi / count + 2 * np.pi * np.arange(count) / count
    radius = 0.5 - ROTOR_RADIUS
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, 0.06)])


def rotor_hubs(drone: Drone) -> NDArray:
    """Positions (m, (rotors, 3)) of the rotor hubs in ENU."""
    return drone.position + drone.size * rotor_places(drone.rotors) @ drone.rotation.T


def outline(drone: Drone) -> NDArray:
    """Points (m, (n, 3)) in ENU whose projections enclose the drone: the rims of its rotors and its feet."""
    angle = np.arange(8) * np.pi / 4
    rim = ROTOR_RADIUS * drone.size * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(8)]) @ drone.rotation.T
    feet = drone.position + drone.size * np.array([[0.1, 0.1, -0.12], [-0.1, -0.1, -0.12]]) @ drone.rotation.T
    return np.concatenate([(rotor_hubs(drone)[:, np.newaxis] + rim).reshape(-1, 3), feet])


@dataclass(frozen=True)
class Appearance:
    """Projection of a drone's outline into the image.

    Parameters:
        box (px): min_x, min_y, max_x, max_y, clipped to the image.
        width_px (px): width before clipping.
        in_view (0 to 1): fraction of the box inside the image.
    """

    box: Box
    width_px: float
    in_view: float

    def window(self, margin: int) -> tuple[slice, slice]:
        """Slices of the rows and columns of the box, extended by `margin` (px)."""
        min_x, min_y, max_x, max_y = self.box
        return (slice(max(int(min_y) - margin, 0), int(max_y) + margin + 1),
                slice(max(int(min_x) - margin, 0), int(max_x) + margin + 1))


def appearance(camera: PinholeCamera, view: View, drone: Drone) -> Appearance | None:
    """Projection of a drone into the image, None if it is out of view.

    Parameters:
        camera: pinhole model of the camera.
        view: pose of the camera.
        drone: pose and size of the drone.
    """
    points = view.to_optical(outline(drone))
    pixels = camera.project(points)    # nan beyond the lens, or what its model says of it
    if (points[:, 2] <= 0.05).any() or np.isnan(pixels).any():
        return None
    edge = np.array([camera.width - 1.0, camera.height - 1.0])
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    inside_low, inside_high = low.clip(0.0, edge), high.clip(0.0, edge)
    in_view = float(np.prod((inside_high - inside_low) / np.maximum(high - low, 1e-9)))
    if in_view <= 0.0:
        return None
    box = (float(inside_low[0]), float(inside_low[1]), float(inside_high[0]), float(inside_high[1]))
    return Appearance(box, float(high[0] - low[0]), in_view)


def score(size_px: float, transmission: float, visible_fraction: float = 1.0) -> float:
    """Score (0 to 1) of a detection, increasing smoothly with apparent size, contrast and visible fraction f.

    The score is f * h(size / HALF_SIZE_PX) * h(transmission / HALF_TRANSMISSION) with Hill's function
    h(x) = x^2 / (1 + x^2), and 0 below LEAST.

    Parameters:
        size_px (px): width of the target.
        transmission (0 to 1): contrast relative to clear air and good light.
        visible_fraction (0 to 1): fraction of the target that is visible.
    """
    def hill(x: float) -> float:
        return x * x / (1.0 + x * x)

    value = visible_fraction * hill(size_px / HALF_SIZE_PX) * hill(transmission / HALF_TRANSMISSION)
    return float(value) if value >= LEAST else 0.0
