"""Messages of the sensors as measurements in the body frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import NDArray

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, attitude_of, checked_orientation
from av_common.gimbal_history import GimbalHistory
from av_common.rig import CAMERAS, camera_topic
from av_common.stamps import to_seconds
from av_common.track import DRONE
from av_fusion.measurement.geometry import detections_in_body, doa_in_body
from av_fusion.measurement.measurements import CameraMeasurement, Detection, DoaMeasurement, usable_camera
from av_fusion.measurement.rig_motion import Pose
from av_fusion.measurement.vectors import ZERO, Vector, rows_of
from av_interfaces.msg import DoaArray
from av_vision.detections import suppress

# From the name of a sensor frame and a capture time (s) to the rotation matrix (3, 3) into the body frame, None where unknown.
RotationOf = Callable[[str, float], NDArray[np.float64] | None]
MOST_BOXES = 200    # of an image: four times as many as detector_node reports
MOST_CLASSES = 100    # whose names are kept
SPEED_LIMIT, RATE_LIMIT = 300.0, 100.0  # m/s, rad/s; larger values are errors of the sender


def fixed_rotations(rotations: Mapping[str, NDArray[np.float64]]) -> RotationOf:
    """Of sensors that do not move on the body: rotation matrices (3, 3) by the name of the sensor's frame."""
    return lambda frame, time: rotations.get(frame)


def gimbal_rotations(fixed: Mapping[str, NDArray[np.float64]], carried: Mapping[str, NDArray[np.float64]],
                     history: GimbalHistory) -> RotationOf:
    """Of sensors of a rig with a gimbal, where there is no tf. Raises NotYetKnownError as the history does.

    Parameters:
        fixed (3, 3): rotation matrices into the body, by the name of the sensor's frame.
        carried (3, 3): those into the gimbal's frame, of sensors on the gimbal.
        history: orientations of the gimbal.
    """
    def rotation_of(frame: str, time: float) -> NDArray[np.float64] | None:
        if frame not in carried:
            return fixed.get(frame)
        sample = history.at(time)
        return None if sample is None else sample.rotation @ carried[frame]

    return rotation_of


class MeasurementConverter:
    """Converts `DoaArray` and `Detection2DArray` messages to measurements.

    Attributes:
        cameras: intrinsics of the rig's cameras that are known, by name; detections of others are not converted.
        problems: reasons why the newest detections or CameraInfo of cameras could not be used, by the cameras' names.
        optical_frames: of the cameras by the names of their frames (x ahead), in which detections are refused.

    Parameters:
        rotation_of: see `RotationOf`.
        target_classes: class names of detections that may be the target.
        cameras: initial value of the attribute; `set_camera_info` replaces it.
    """

    def __init__(self, rotation_of: RotationOf, target_classes: Sequence[str] = (DRONE,),
                 cameras: Mapping[str, PinholeCamera] | None = None) -> None:
        self._rotation_of = rotation_of
        self._target_classes = frozenset(target_classes)
        self._classes: set[str] = set()
        self.cameras = dict(cameras or {})
        self.optical_frames: dict[str, str] = {}
        self.problems: dict[str, str] = {}

    def set_camera_info(self, message: Any, camera: str = CAMERAS[0]) -> None:
        """Take the model of a camera; one that cannot be used is reported in `problems`.

        Parameters:
            message: a `sensor_msgs/CameraInfo`.
            camera: the camera's name.
        """
        try:
            model = PinholeCamera.from_camera_info(message)
        except ValueError as error:
            self.problems[camera] = f'{_info(camera)}: {error}'
            return
        self.problems.pop(camera, None)
        if model != self.cameras.get(camera):  # it comes with every image, and keeps what it has computed
            self.cameras[camera] = model

    @property
    def foreign_classes(self) -> list[str]:
        """Names of the classes seen where none of them is a target's."""
        return [] if self._classes & self._target_classes else sorted(self._classes)

    def doa(self, message: DoaArray, odds: tuple[float, ...] = ()) -> list[DoaMeasurement]:
        """One measurement for each ambiguity group, most confident first; none if the array's frame is unknown.

        Parameters:
            message: directions of one window.
            odds: see `DoaMeasurement`, of the strongest source.
        """
        header = message.header
        rotation = self._rotation_of(header.frame_id, to_seconds(header.stamp)) if message.hypotheses else None
        return [] if rotation is None else doa_in_body(message, rotation, odds)

    def detections(self, message: Any, visibility: float = math.nan, searched: float = 1.0,
                   camera: str = CAMERAS[0]) -> CameraMeasurement | None:
        """The detections of target classes in a `vision_msgs/Detection2DArray`; None if frame or camera are unknown.

        Parameters:
            message: the detections.
            visibility: visibility 0..1 of the image, NaN if unknown.
            searched: share of the view that was searched where anything is detected; an image without stands for all of it.
            camera: the camera's name.

        Raises ValueError where all boxes of target classes are impossible (such an image is no empty one), and for a frame that
        is no optical one.
        """
        frame = message.header.frame_id
        if frame in self.optical_frames:
            raise ValueError(f'detections are in {frame!r}, which has x ahead, expected the optical frame '
                             f'{self.optical_frames[frame]!r} (z ahead): set frame_id of the camera driver')
        model = self.cameras.get(camera)
        if model is None:
            self.problems.setdefault(camera, f'no {_info(camera)}: detections cannot be converted to bearings')
            return None
        time = to_seconds(message.header.stamp)
        rotation = self._rotation_of(frame, time)
        if rotation is None:
            return None
        return usable_camera(CameraMeasurement(
            time, self._detections(message, model, camera, rotation), 0.5 * model.horizontal_fov_rad,
            0.5 * model.vertical_fov_rad, visibility, rows_of(rotation @ model.view @ FLU_TO_OPTICAL), camera,
            searched if message.detections else 1.0))

    def _detections(self, message: Any, model: PinholeCamera, camera: str, rotation: NDArray[np.float64]
                    ) -> tuple[Detection, ...]:
        boxes = []
        for detection in message.detections:
            hypotheses = [result.hypothesis for result in detection.results]
            names = {h.class_id for h in hypotheses}
            self._classes |= names if len(self._classes) < MOST_CLASSES else names & self._target_classes
            scores = [h.score for h in hypotheses if h.class_id in self._target_classes]
            if scores:
                box = detection.bbox
                boxes.append((box.center.position.x, box.center.position.y, box.size_x, box.size_y, max(scores)))
        if not boxes:  # most images of a search
            return ()
        table = objects(possible(np.array(boxes), model, camera))
        return tuple(detections_in_body(model, table[:, :2], table[:, 2:4], table[:, 4], rotation))


def _info(camera: str) -> str:
    """The topic of the model of a camera."""
    return camera_topic(camera, 'camera/camera_info')


def possible(boxes: NDArray[np.float64], model: PinholeCamera, camera: str = CAMERAS[0]) -> NDArray[np.float64]:
    """The rows of boxes (n, 5) that may be objects in an image of a camera. Raises ValueError where none is.

    Parameters:
        boxes (n, 5): centre and size in pixels, score.
        model: intrinsics.
        camera: its name.
    """
    centres, sizes, scores = boxes[:, :2], boxes[:, 2:4], boxes[:, 4]
    # Of a box in shares of the image all values are below one pixel; one without size is a point.
    shares = ((boxes[:, :4] >= 0.0) & (boxes[:, :4] <= 1.0)).all(axis=1) & (sizes > 0.0).any(axis=1)
    inside = (centres + 0.5 * sizes >= -0.5) & (centres - 0.5 * sizes <= (model.width - 0.5, model.height - 0.5))
    checks = {'a score beyond 0 to 1': (scores >= 0.0) & (scores <= 1.0),
              'a negative size': (sizes >= 0.0).all(axis=1), 'shares of the image instead of pixels': ~shares,
              f'a place outside the images of {model.width} x {model.height} pixels of {_info(camera)}':
              inside.all(axis=1) & np.isfinite(boxes).all(axis=1)}
    kept = np.all(list(checks.values()), axis=0)
    if not kept.any():
        raise ValueError(f'boxes have {", ".join(name for name, good in checks.items() if not good.all())}')
    return boxes[kept]


def objects(boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rows of boxes (n, 5) of one image, each of another object: a detector may report one twice, or as two classes.

    Parameters:
        boxes (n, 5): centre and size in pixels, score.
    """
    if len(boxes) < 2:
        return boxes
    boxes = boxes[np.argsort(-boxes[:, 4], kind='stable')[:MOST_BOXES]]
    half = 0.5 * np.maximum(boxes[:, 2:4], 1.0)
    corners = np.concatenate([boxes[:, :2] - half, boxes[:, :2] + half], axis=1)
    return boxes[suppress(corners, boxes[:, 4])]


def pose_of(message: Odometry) -> Pose:
    """The pose of an Odometry (pose in ENU, twist in the body frame, FLU). Raises ValueError for one without attitude."""
    attitude, twist = checked_orientation(attitude_of(message.pose.pose.orientation), 'attitude'), message.twist.twist
    return Pose(to_seconds(message.header.stamp), attitude,
                _usable(twist.angular, RATE_LIMIT) or ZERO, _usable(twist.linear, SPEED_LIMIT) or ZERO,
                _usable(message.pose.pose.position, math.inf))


def _usable(message: Any, limit: float) -> Vector | None:
    """A vector of three finite values within +-limit, else None: an estimator may know the attitude alone."""
    vector = message.x, message.y, message.z
    return vector if all(math.isfinite(value) and abs(value) <= limit for value in vector) else None
