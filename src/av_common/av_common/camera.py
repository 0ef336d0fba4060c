"""The geometry of a camera: pinhole or fisheye with the lens models of ROS, binning, and regions of interest."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

# Of a CameraInfo and of calibration files, where an empty name means the first. The first two are one polynomial in OpenCV.
LENS_MODELS = ('plumb_bob', 'rational_polynomial', 'equidistant')
DISTORTION_LENGTHS, EQUIDISTANT_LENGTHS = (0, 4, 5, 8, 12, 14), (0, 4)
PRECISE = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-10)
# OpenCV 4 has a separate function for a given precision, OpenCV 5 an argument.
UNDISTORT: Any = getattr(cv2, 'undistortPointsIter', cv2.undistortPoints)
ANGLES = np.linspace(0.0, math.pi, 4097)  # off the axis (rad); of a fisheye lens the error between these is below 1e-7 rad
HALF = len(ANGLES) // 2                   # of them are below a right angle
UNDONE = 0.1  # pixels by which the projection of a ray may miss its pixel
_SIZE, _FOCAL, _CENTRE = (1, 100_000), (1e-3, 1e7), (-1e6, 1e6)
_LIMITS: dict[str, tuple[float, float]] = {
    'width': _SIZE, 'height': _SIZE, 'fx': _FOCAL, 'fy': _FOCAL, 'cx': _CENTRE, 'cy': _CENTRE}
_MOST_COEFFICIENT = 1e4  # of distortion; larger ones are garbage
_MOST_TANGENT = 20.0    # of half the angle that a calibrated image shows: 174 deg of a pinhole lens, 2292 of a fisheye
_NONE = 1e-3            # pixels: a larger skew, or value where the intrinsic matrix has zeros, makes it another matrix


@dataclass(frozen=True)
class PinholeCamera:
    """A camera with one centre of projection and a lens: pinhole with distortion, or fisheye.

    Points are in the optical frame (REP-103: x right, y down, z forward); pixel (0, 0) is the centre of the top-left pixel.

    Parameters:
        width, height (pixels): size of the image.
        fx, fy (pixels): focal lengths.
        cx, cy (pixels): principal point.
        distortion: coefficients k1 k2 p1 p2 [k3 [k4 k5 k6 ...]] in OpenCV's order, of a fisheye lens k1 k2 k3 k4; empty for an
            ideal lens.
        equidistant: whether the lens is a fisheye (Kannala and Brandt, 2006): what is the angle a off the axis appears
            a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8) focal lengths from the principal point.

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
    equidistant: bool = False

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f'{name} is {getattr(self, name)}, expected {low:g} to {high:g} pixels')
        object.__setattr__(self, 'distortion', tuple(float(k) for k in self.distortion))
        lengths = EQUIDISTANT_LENGTHS if self.equidistant else DISTORTION_LENGTHS
        if len(self.distortion) not in lengths or not all(abs(k) <= _MOST_COEFFICIENT for k in self.distortion):
            raise ValueError(f'distortion is {self.distortion}, expected one of {lengths} coefficients within '
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
    def from_calibration(cls, width: int, height: int, k: ArrayLike, model: str, distortion: ArrayLike) -> PinholeCamera:
        """The camera of a calibration as ROS writes it.

        Parameters:
            width, height (pixels): size of the images of the calibration.
            k (9,): the intrinsic matrix, row by row.
            model: one of LENS_MODELS, or empty.
            distortion: coefficients.

        Raises ValueError for an uncalibrated camera (k[0] is 0, as CameraInfo defines), for other lens models, and for a matrix
        that is transposed, has a skew, or is not in pixels.
        """
        matrix, coefficients = np.asarray(k, float).reshape(-1), np.asarray(distortion, float).reshape(-1)
        if matrix.size != 9 or matrix[0] == 0.0:
            raise ValueError(f'k is {matrix.tolist()}: the camera is not calibrated')
        if np.abs(matrix[[1, 3, 6, 7]]).max() > _NONE:
            raise ValueError(f'k is {matrix.tolist()}, expected fx, 0, cx, 0, fy, cy, 0, 0, 1')
        if 0.0 < _MOST_TANGENT * matrix[0] < 0.5 * width or 0.0 < _MOST_TANGENT * matrix[4] < 0.5 * height:
            raise ValueError(f'k has the focal lengths {matrix[0]:g} and {matrix[4]:g} for {width} x {height} pixels, expected '
                             'pixels of these images')
        if model and model not in LENS_MODELS:
            raise ValueError(f'distortion_model is {model[:40]!r}, expected {", ".join(LENS_MODELS)}')
        return cls(int(width), int(height), matrix[0], matrix[4], matrix[2], matrix[5],
                   tuple(coefficients if coefficients.any() else ()), model == 'equidistant')

    @classmethod
    def from_camera_info(cls, info: Any) -> PinholeCamera:
        """The camera of the images that belong to a `sensor_msgs/CameraInfo`, of any library.

        The message describes the whole sensor; the images may show a region of it, and their pixels may be blocks of the
        sensor's.

        Raises ValueError as `from_calibration`, and for a region that is not on the sensor.
        """
        camera = cls.from_calibration(info.width, info.height, info.k, info.distortion_model, info.d)
        left, top = info.roi.x_offset, info.roi.y_offset
        width, height = info.roi.width or info.width - left, info.roi.height or info.height - top    # 0 is the rest
        if not (width > 0 and height > 0 and left + width <= info.width and top + height <= info.height):
            raise ValueError(f'a region of {width} x {height} pixels at {left}, {top} is not within '
                             f'{info.width} x {info.height}')
        camera = replace(camera, width=width, height=height, cx=camera.cx - left, cy=camera.cy - top)
        across, down = max(info.binning_x, 1), max(info.binning_y, 1)
        return camera._resized(max(camera.width // across, 1), max(camera.height // down, 1), 1.0 / across, 1.0 / down)

    @cached_property
    def matrix(self) -> NDArray[np.float64]:
        """Intrinsic matrix K (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @cached_property
    def _coefficients(self) -> NDArray[np.float64]:
        return np.array(self.distortion)

    @cached_property
    def _bends(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Increasing distances from the principal point (focal lengths, no tangential distortion), and angles (rad) off it.

        They end where the distances fall: the polynomial says nothing about the lens beyond.
        """
        polyval, k = np.polynomial.polynomial.polyval, np.zeros(14)
        k[:len(self.distortion)] = self.distortion
        if self.equidistant:
            angles, distances = ANGLES, ANGLES * polyval(ANGLES**2, [1.0, *k[:4]])
        else:
            angles, plane = ANGLES[:HALF], np.tan(ANGLES[:HALF])
            distances = plane * polyval(plane**2, [1.0, k[0], k[1], k[4]]) / polyval(plane**2, [1.0, *k[5:8]])
        falls = np.diff(distances) <= 0.0
        end = int(falls.argmax()) + 1 if falls.any() else len(angles)
        return distances[:end], angles[:end]

    @cached_property
    def _edges_rad(self) -> tuple[float, float, float, float]:
        """Angles of the middles of the left, right, upper and lower edge off the optical axis, to the right and down."""
        column, row = 0.5 * (self.width - 1), 0.5 * (self.height - 1)
        x, y, z = self.rays([(-0.5, row), (self.width - 0.5, row), (column, -0.5), (column, self.height - 0.5)]).T
        angles = np.concatenate([np.arctan2(x, z)[:2], np.arctan2(y, np.hypot(x, z))[2:]])
        if self.distortion or self.equidistant:  # the picture is round, and may end before the image does
            angles = np.where(np.isnan(angles), self._bends[1][-1] * np.array([-1.0, 1.0, -1.0, 1.0]), angles)
        left, right, upper, lower = angles.tolist()
        return left, right, upper, lower

    @property
    def horizontal_fov_rad(self) -> float:
        """Angle in rad between the middles of the left and the right edge of the image."""
        return self._edges_rad[1] - self._edges_rad[0]

    @property
    def vertical_fov_rad(self) -> float:
        """Angle in rad between the middles of the upper and the lower edge of the image."""
        return self._edges_rad[3] - self._edges_rad[2]

    @cached_property
    def view(self) -> NDArray[np.float64]:
        """Rotation matrix (3, 3) to the optical frame from a frame that looks (z) at the middle of the field of view.

        A region of interest may be anywhere beside the optical axis.
        """
        left, right, upper, lower = self._edges_rad
        (pan, tilt) = 0.5 * (left + right), 0.5 * (upper + lower)
        (s, c), (u, v) = (math.sin(pan), math.cos(pan)), (math.sin(tilt), math.cos(tilt))
        return np.array([[c, -s * u, s * v], [0.0, v, u], [-s, -c * u, c * v]])

    def scaled(self, width: int, height: int) -> PinholeCamera:
        """Intrinsics for images that are resized to width x height pixels.

        Parameters:
            width, height (pixels): new size of the images.

        Raises ValueError for a size whose sides have another ratio, by more than rounding to pixels: that is another camera.
        """
        if (width, height) == (self.width, self.height):
            return self
        across, down = width / self.width, height / self.height
        if not abs(across - down) < 1.0 / self.width + 1.0 / self.height:
            raise ValueError(f'images of {width} x {height} pixels do not fit a camera calibrated for '
                             f'{self.width} x {self.height}')
        return self._resized(width, height, across, down)

    def _resized(self, width: int, height: int, across: float, down: float) -> PinholeCamera:
        """The camera of width x height pixels, each of which is 1 / across x 1 / down pixels of this one."""
        return replace(self, width=width, height=height, fx=self.fx * across, fy=self.fy * down,
                       cx=(self.cx + 0.5) * across - 0.5, cy=(self.cy + 0.5) * down - 0.5)

    def project(self, points_optical: ArrayLike) -> NDArray[np.float64]:
        """Pixels (n, 2) of points (n, 3) in metres; nan beside the lens (a pinhole: at or behind it) or its model."""
        points = np.asarray(points_optical, float).reshape(-1, 3)
        across = np.hypot(points[:, 0], points[:, 1])
        if self.equidistant:
            distances, angles = self._bends
            reach = np.interp(np.arctan2(across, points[:, 2]), angles, distances, right=math.nan)
            plane = points[:, :2] * (reach / np.where(across > 0.0, across, 1.0))[:, None]
            return plane * (self.fx, self.fy) + (self.cx, self.cy)
        pixels = np.full((len(points), 2), np.nan)
        ahead = points[:, 2] > 0.0
        if not self.distortion:  # in a third of the time
            with np.errstate(over='ignore'):
                pixels[ahead] = points[ahead, :2] / points[ahead, 2:] * (self.fx, self.fy) + (self.cx, self.cy)
            return pixels
        ahead &= np.arctan2(across, points[:, 2]) <= self._bends[1][-1]
        if ahead.any():
            zero = np.zeros(3)
            pixels[ahead] = cv2.projectPoints(points[ahead], zero, zero, self.matrix, self._coefficients)[0][:, 0]
        return pixels

    def rays(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Undistorted unit vectors (n, 3) in the optical frame towards pixels (n, 2); nan beyond the model of the lens."""
        pixels = np.asarray(pixels, float).reshape(-1, 2)
        plane = (pixels - (self.cx, self.cy)) / (self.fx, self.fy)
        if self.equidistant:
            reach = np.hypot(plane[:, 0], plane[:, 1])
            angle = np.interp(reach, *self._bends, right=math.nan)
            return np.column_stack([plane * (np.sin(angle) / np.where(reach > 0.0, reach, 1.0))[:, None], np.cos(angle)])
        if len(pixels) and self.distortion:
            plane = UNDISTORT(pixels[:, None], self.matrix, self._coefficients, R=None, P=None, criteria=PRECISE)[:, 0]
        rays = np.column_stack([plane, np.ones(len(plane))])
        if len(pixels) and self.distortion:
            rays[~(np.abs(self.project(rays) - pixels) <= UNDONE).all(axis=1)] = math.nan
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)
