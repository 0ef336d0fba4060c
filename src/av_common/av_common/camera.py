"""Pinhole camera with the lens distortion of ROS (plumb_bob, rational_polynomial)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)
PRECISE = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-10)
# OpenCV 4 has a separate function for a given precision, OpenCV 5 an argument.
UNDISTORT: Any = getattr(cv2, 'undistortPointsIter', cv2.undistortPoints)
_SIZE, _FOCAL, _CENTRE = (1, 100_000), (1e-3, 1e7), (-1e6, 1e6)
_LIMITS: dict[str, tuple[float, float]] = {
    'width': _SIZE, 'height': _SIZE, 'fx': _FOCAL, 'fy': _FOCAL, 'cx': _CENTRE, 'cy': _CENTRE}
_MOST_COEFFICIENT = 1e4


@dataclass(frozen=True)
class PinholeCamera:
    """A pinhole camera with lens distortion.

    Points are in the optical frame (REP-103: x right, y down, z forward); pixel (0, 0) is the centre of the top-left pixel.

    Parameters:
        width, height (pixels): size of the image.
        fx, fy (pixels): focal lengths.
        cx, cy (pixels): principal point.
        distortion: coefficients k1 k2 p1 p2 [k3 [k4 k5 k6 ...]] in OpenCV's order; empty for an ideal lens.

    Raises ValueError naming the parameter that is out of range: no real camera has more than 100,000 pixels in a row, focal
    lengths outside 1e-3 to 1e7 pixels, a principal point beyond 1e6 pixels, or coefficients beyond 1e4.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f'{name} is {getattr(self, name)}, expected {low:g} to {high:g} pixels')
        object.__setattr__(self, 'distortion', tuple(float(k) for k in self.distortion))
        if len(self.distortion) not in DISTORTION_LENGTHS or not all(abs(k) <= _MOST_COEFFICIENT for k in self.distortion):
            raise ValueError(f'distortion is {self.distortion}, expected one of {DISTORTION_LENGTHS} coefficients within '
                             f'+-{_MOST_COEFFICIENT:g}')

    @classmethod
    def from_fov(cls, width: int, height: int, horizontal_fov_rad: float) -> PinholeCamera:
        """An ideal camera with square pixels and the principal point in the middle of the image.

        Parameters:
            width, height (pixels): size of the image.
            horizontal_fov_rad (rad): angle between its left and right edge, within (0, pi).
        """
        if not 0.0 < horizontal_fov_rad < math.pi:
            raise ValueError(f'horizontal_fov_rad is {horizontal_fov_rad}, expected an angle between 0 and pi')
        focal = 0.5 * width / math.tan(0.5 * horizontal_fov_rad)
        return cls(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))

    @classmethod
    def from_camera_info(cls, info: Any) -> PinholeCamera:
        """The camera of a `sensor_msgs/CameraInfo`, or of an object with its fields `width`, `height`, `k` (9) and `d`.

        Raises ValueError for an uncalibrated camera (k[0] is 0, as the message defines) and for other lens models.
        """
        k = np.asarray(info.k, float).reshape(-1)
        model = getattr(info, 'distortion_model', '') or 'plumb_bob'
        if k.size != 9 or k[0] == 0.0:
            raise ValueError(f'k of the camera info is {k.tolist()}: the camera is not calibrated')
        if model not in ('plumb_bob', 'rational_polynomial'):
            raise ValueError(f'distortion_model is {model!r}, expected plumb_bob or rational_polynomial')
        distortion = np.asarray(info.d, float)
        return cls(int(info.width), int(info.height), k[0], k[4], k[2], k[5], tuple(distortion if distortion.any() else ()))

    @cached_property
    def matrix(self) -> NDArray[np.float64]:
        """Intrinsic matrix K (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @cached_property
    def _coefficients(self) -> NDArray[np.float64]:
        return np.array(self.distortion)

    @cached_property
    def horizontal_fov_rad(self) -> float:
        """Angle in rad between the left and the right edge of the image, distortion ignored."""
        return math.atan((self.cx + 0.5) / self.fx) + math.atan((self.width - 0.5 - self.cx) / self.fx)

    def scaled(self, width: int, height: int) -> PinholeCamera:
        """Intrinsics for images that are resized to width x height pixels.

        Parameters:
            width, height (pixels): new size of the images.
        """
        sx, sy = width / self.width, height / self.height
        return PinholeCamera(width, height, self.fx * sx, self.fy * sy,
                             (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5, self.distortion)

    def project(self, points_optical: ArrayLike) -> NDArray[np.float64]:
        """Pixels (n, 2) of points (n, 3) in metres; nan for points at or behind the lens."""
        points = np.asarray(points_optical, float).reshape(-1, 3)
        pixels = np.full((len(points), 2), np.nan)
        ahead = points[:, 2] > 0.0
        if not self.distortion:  # in a third of the time
            with np.errstate(over='ignore'):
                pixels[ahead] = points[ahead, :2] / points[ahead, 2:] * (self.fx, self.fy) + (self.cx, self.cy)
        elif ahead.any():
            zero = np.zeros(3)
            pixels[ahead] = cv2.projectPoints(points[ahead], zero, zero, self.matrix, self._coefficients)[0][:, 0]
        return pixels

    def on_plane(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Undistorted points (n, 2) at which the rays through pixels (n, 2) meet the plane z = 1 of the optical frame."""
        pixels = np.asarray(pixels, float).reshape(-1, 2)
        if not len(pixels) or not self.distortion:
            return (pixels - (self.cx, self.cy)) / (self.fx, self.fy)
        return UNDISTORT(pixels[:, None], self.matrix, self._coefficients, R=None, P=None, criteria=PRECISE)[:, 0]

    def rays(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Undistorted unit vectors (n, 3) in the optical frame towards pixels (n, 2)."""
        plane = self.on_plane(pixels)
        rays = np.column_stack([plane, np.ones(len(plane))])
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)
