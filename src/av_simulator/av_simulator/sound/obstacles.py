"""Obstacles to sound, as upright prisms, and the lengths of the paths around them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from av_common.config_reader import bounded

_GAP_M = 0.05  # m, height of the bottom edge below which there is no path under an obstacle
BANDS_HZ = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)  # octaves in which tables give absorption

Absorption = Sequence[float]  # absorption coefficients (0 to 1, by energy): one for all bands, or one for each of BANDS_HZ


def reflection_factor(absorption: Absorption, frequency_hz: NDArray) -> NDArray:
    """Reflection factor of the amplitude, sqrt(1 - absorption), interpolated between bands on a logarithmic axis.

    Raises ValueError for coefficients outside 0 to 1 or a wrong number of bands.

    Parameters:
        absorption: absorption coefficients.
        frequency_hz (Hz): frequencies, of any shape.
    """
    values = np.atleast_1d(np.asarray(absorption, float))
    if values.shape not in ((1,), (len(BANDS_HZ),)) or values.min() < 0.0 or values.max() > 1.0:
        raise ValueError(f'absorption is {absorption}, expected one number from 0 to 1, or one for each of {BANDS_HZ} Hz')
    if len(values) == 1:
        return np.full(np.shape(frequency_hz), np.sqrt(1.0 - values[0]))
    place = np.log2(np.maximum(frequency_hz, 1.0))
    return np.sqrt(1.0 - np.interp(place, np.log2(BANDS_HZ), values))


@dataclass(frozen=True, eq=False)
class Box:
    """A box, such as a wall or a whiteboard.

    Parameters:
        center (m, ENU): x, y, z of the centre.
        size (m): extents along the box's axes.
        yaw_deg (deg): rotation about the vertical, counter-clockwise.
        absorption: absorption coefficients of the faces, one value or one for each octave.
        reflects: whether the faces reflect sound.
    """

    center: Sequence[float] = bounded(low=-1e4, high=1e4, longest=3)
    size: Sequence[float] = bounded(low=0.0, high=1e4, longest=3)
    yaw_deg: float = 0.0
    absorption: Absorption = (0.1,)
    reflects: bool = True

    def __post_init__(self) -> None:
        if len(self.center) != 3 or len(self.size) != 3 or min(self.size) <= 0.0:
            raise ValueError(f'box center is {list(self.center)} and size {list(self.size)}, '
                             'expected x, y, z and three positive lengths')
        reflection_factor(self.absorption, np.zeros(1))

    @cached_property
    def footprint(self) -> NDArray:
        """Corners (m, (n, 2)) in ENU, counter-clockwise, of a convex outline."""
        yaw = np.deg2rad(self.yaw_deg)
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.asarray(self.size[:2], float) / 2.0
        return corners @ turn.T + np.asarray(self.center[:2], float)

    @property
    def bottom(self) -> float:
        """Height of the lower end (m, z in ENU)."""
        return self.center[2] - self.size[2] / 2.0

    @property
    def top(self) -> float:
        """Height of the upper end (m, z in ENU)."""
        return self.center[2] + self.size[2] / 2.0

    def faces(self) -> Iterator[tuple[NDArray, float]]:
        """Outward unit normals ((3,)) and offsets (m, normal @ point) of the planes of the vertical faces and the top."""
        for here, there in zip(self.footprint, np.roll(self.footprint, -1, axis=0), strict=True):
            edge = (there - here) / np.hypot(*(there - here))
            normal = np.array([edge[1], -edge[0], 0.0])
            yield normal, float(normal[:2] @ here)
        yield np.array([0.0, 0.0, 1.0]), self.top

    def holds(self, point: NDArray) -> bool:
        """Whether a point (m, (3,)) of a face's plane lies on the face."""
        edge = np.roll(self.footprint, -1, axis=0) - self.footprint
        inward = edge[:, 0] * (point[1] - self.footprint[:, 1]) - edge[:, 1] * (point[0] - self.footprint[:, 0])
        return bool(inward.min() > -1e-6 and self.bottom <= point[2] <= self.top + 1e-6)


@dataclass(frozen=True, eq=False)
class Trunk:
    """A tree trunk or a column, as an octagonal prism without reflections.

    Parameters:
        center (m, ENU): x, y of the centre.
        radius (m): radius of the corners.
        top, bottom (m): z of the ends.
    """

    center: Sequence[float] = bounded(low=-1e4, high=1e4, longest=2)
    radius: float = bounded(0.2, above=0.0, high=1e3)
    top: float = 10.0
    bottom: float = 0.0

    def __post_init__(self) -> None:
        if len(self.center) != 2 or self.radius <= 0.0 or self.top <= self.bottom:
            raise ValueError(f'trunk center is {list(self.center)}, radius {self.radius}, bottom {self.bottom} and top '
                             f'{self.top}, expected x, y, a positive radius and bottom < top')

    @cached_property
    def footprint(self) -> NDArray:
        """Corners (m, (n, 2)) in ENU, counter-clockwise, of a convex outline."""
        angle = np.arange(8) * np.pi / 4.0
        return np.asarray(self.center, float) + self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


OBSTACLES = {'box': Box, 'trunk': Trunk}  # classes by their names in scenarios
Obstacle = Box | Trunk


def detours(obstacle: Obstacle, source: NDArray, receiver: NDArray) -> NDArray | None:
    """Extra lengths (m, (3,) or (4,)) of the paths left, right, over and, given a gap, under an obstacle.

    A negative length belongs to an edge that the straight line passes on the open side; its magnitude is the extra length of
    the path over that edge. None if the obstacle is not between source and receiver.

    Parameters:
        obstacle: the obstacle.
        source, receiver (m, (3,)): positions in ENU.
    """
    rise = float(receiver[2] - source[2])
    length = float(np.hypot(*(receiver - source)[:2]))
    if length < 1e-6:
        return None
    forward = (receiver - source)[:2] / length
    to_line = np.array([[forward[0], -forward[1]], [forward[1], forward[0]]])
    corners = (obstacle.footprint - source[:2]) @ to_line  # along the line, and to its left
    between = _part_above(_part_above(corners, 0.0, 1.0), -length, -1.0)
    if len(between) == 0:
        return None
    straight = float(np.hypot(length, rise))
    ways = []
    for side in (1.0, -1.0):
        detour = _signed_detour(corners * [1.0, side], between * [1.0, side], length)
        ways.append(np.hypot(length + detour, rise) - straight if detour > 0.0 else detour)
    tilt = np.array([[length, -rise], [rise, length]]) / straight
    entered = _crossing(between)
    for height, side in ((obstacle.top, 1.0), (obstacle.bottom, -1.0)):
        edges = np.stack([entered, np.full(2, height - source[2])], axis=1) @ tilt * [1.0, side]
        ways.append(_signed_detour(edges, edges, straight))
    return np.array(ways if obstacle.bottom > _GAP_M else ways[:3])


def _signed_detour(corners: NDArray, between: NDArray, length: float) -> float:
    """Extra length over the corners above the line; minus that over the nearest corner if all are below the line."""
    above = corners[corners[:, 1] > 0.0]
    if len(above) and between[:, 1].max() > 0.0:
        return _detour(above, length)
    return -_detour(between[[np.argmin(np.abs(between[:, 1]))]], length)


def _part_above(polygon: NDArray, limit: float, sign: float) -> NDArray:
    """The part of a convex polygon with sign * x >= limit (Sutherland and Hodgman)."""
    kept = []
    for here, there in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        a, b = sign * here[0] - limit, sign * there[0] - limit
        if a >= 0.0:
            kept.append(here)
        if a * b < 0.0:
            kept.append(here + (there - here) * (a / (a - b)))
    return np.array(kept).reshape(-1, 2)


def _crossing(polygon: NDArray) -> NDArray:
    """Coordinates x at which the line y = 0 enters and leaves a convex polygon; twice the nearest corner if it misses."""
    after = np.roll(polygon, -1, axis=0)
    cut = (polygon[:, 1] < 0.0) != (after[:, 1] < 0.0)
    if not cut.any():
        return np.full(2, polygon[np.argmin(np.abs(polygon[:, 1])), 0])
    here, there = polygon[cut], after[cut]
    return np.sort(here[:, 0] - here[:, 1] * (there[:, 0] - here[:, 0]) / (there[:, 1] - here[:, 1]))


def _detour(corners: NDArray, length: float) -> float:
    """Extra length of the shortest path from (0, 0) to (length, 0) around corners (n, 2) on one side.

    The path and the straight line between its ends are the outline of a convex hull.
    """
    points = sorted([(0.0, 0.0), (length, 0.0), *map(tuple, corners.tolist())])
    outline = _chain(points) + _chain(points[::-1])
    steps = np.diff(np.array([*outline, outline[0]]), axis=0)
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum()) - 2.0 * length


def _chain(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """One half of the convex hull of sorted points, without its last point (Andrew's monotone chain)."""
    chain: list[tuple[float, float]] = []
    for x, y in points:
        while len(chain) > 1 and ((chain[-1][0] - chain[-2][0]) * (y - chain[-2][1])
                                  - (chain[-1][1] - chain[-2][1]) * (x - chain[-2][0])) <= 0.0:
            chain.pop()
        chain.append((x, y))
    return chain[:-1]
