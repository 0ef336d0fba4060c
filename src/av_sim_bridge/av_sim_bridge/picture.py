"""What a camera sees: the interface of every renderer, and what they share."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from av_sim_bridge.visibility import credibility, transmission
from av_sim_bridge.wire.oracle import OracleBox
from av_vision.camera import PinholeCamera

_ROTORS = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) / (2 * np.sqrt(2))   # of a quadrotor of size 1


@dataclass(frozen=True)
class Drone:
    """A drone in view: position m ENU (3,), rotation (3, 3) from its body (FLU) to ENU, size m from tip to tip."""

    target_id: int
    position: NDArray
    rotation: NDArray
    size: float


@dataclass(frozen=True)
class View:
    """One instant as a camera at `position` (3,) with `rotation` (3, 3) from its optical frame to ENU has it before it.

    index: number of the picture, which also seeds its noise.  fog: extinction coefficient in 1/m.
    """

    index: int
    time: float
    position: NDArray
    rotation: NDArray
    fog: float = 0.0
    drones: list[Drone] = field(default_factory=list)

    def to_optical(self, points: NDArray) -> NDArray:
        """World points (n, 3) in the optical frame."""
        return (np.asarray(points) - self.position) @ self.rotation


@dataclass(frozen=True)
class Picture:
    """bgr: (height, width, 3) uint8.  boxes: what the visual oracle reports."""

    bgr: NDArray
    boxes: list[OracleBox]


class Renderer(Protocol):
    """Makes pictures of views."""

    def render(self, view: View) -> Picture:
        """The picture of one view; the same view gives the same picture."""


def rotor_hubs(drone: Drone) -> NDArray:
    """Hubs (4, 3) of the rotors in ENU."""
    radius = 0.15
    arms = np.column_stack([_ROTORS * (1 - 2 * radius), np.full(4, 0.06)]) * drone.size
    return drone.position + arms @ drone.rotation.T


def outline(drone: Drone) -> NDArray:
    """Points (n, 3) in ENU whose projections span the drone: the rims of its rotors and its feet."""
    angle = np.arange(8) * np.pi / 4
    rim = 0.15 * drone.size * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(8)]) @ drone.rotation.T
    feet = drone.position + drone.size * np.array([[0.1, 0.1, -0.12], [-0.1, -0.1, -0.12]]) @ drone.rotation.T
    return np.concatenate([(rotor_hubs(drone)[:, np.newaxis] + rim).reshape(-1, 3), feet])


def oracle_box(camera: PinholeCamera, view: View, drone: Drone, visible: float = 1.0) -> OracleBox | None:
    """The oracle's box of one drone of which the share `visible` is not hidden by others, None where it is unseen."""
    points = view.to_optical(outline(drone))
    if (points[:, 2] <= 0.05).any():
        return None
    pixels = camera.project(points)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    edge = np.array([camera.width - 1.0, camera.height - 1.0])
    inside_low, inside_high = low.clip(0.0, edge), high.clip(0.0, edge)
    in_view = float(np.prod((inside_high - inside_low) / np.maximum(high - low, 1e-9)))
    if not _in_field_of_view(camera, points, pixels):
        return None
    distance = float(np.linalg.norm(drone.position - view.position))
    value = credibility(float(high[0] - low[0]), float(transmission(view.fog, distance)), visible * in_view)
    return OracleBox(drone.target_id, value, *map(float, [*inside_low, *inside_high])) if value > 0 else None


def _in_field_of_view(camera: PinholeCamera, points: NDArray, pixels: NDArray) -> bool:
    """Far outside, a distortion polynomial can fold points back into the image; there the angle decides."""
    angle = np.abs(np.arctan2(points[:, 0], points[:, 2])).min()
    inside = ((pixels >= 0) & (pixels <= [camera.width - 1, camera.height - 1])).all(axis=1)
    return bool(inside.any() and angle < 0.75 * camera.horizontal_fov_rad)
