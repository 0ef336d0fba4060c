"""Odometry of a sensor, such as that of an IMU or a tracking camera, as that of the body that carries it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from std_msgs.msg import Header
from transforms3d.quaternions import mat2quat, quat2mat

from av_common.frames import BASE_FRAME, attitude_of, is_orientation
from av_common.gimbal_history import NotYetKnownError
from av_common.pose_messages import odometry_message
from av_common.quaternions import Quaternion, inverse, product
from av_common.stamps import to_seconds, to_stamp

TF_WAIT_S = 1.0    # for the fixed frames, which come late where their publisher is found late
MOST_FRAMES = 500  # of all robots on one tf


class FixedFrames:
    """Rotations between frames that do not move on each other, as `tf_static` has them."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, NDArray[np.float64]]] = {}

    def learn(self, transforms: Iterable[Any]) -> list[str]:
        """Take transforms, at most MOST_FRAMES; returns the frames of those whose rotation is no unit quaternion."""
        impossible = []
        for transform in transforms:
            attitude, frame = attitude_of(transform.transform.rotation), transform.child_frame_id.removeprefix('/')
            if not is_orientation(attitude):
                impossible.append(frame)
            elif frame in self._parents or len(self._parents) < MOST_FRAMES:
                self._parents[frame] = transform.header.frame_id.removeprefix('/'), quat2mat(attitude)
        return impossible

    def ancestors(self, frame: str) -> Iterator[tuple[str, NDArray[np.float64]]]:
        """The frame and those that carry it, the nearest first, each with the rotation (3, 3) into it."""
        rotation, seen = np.eye(3), set()
        while frame not in seen:
            yield frame, rotation
            seen.add(frame)
            frame, step = self._parents.get(frame, (frame, rotation))
            rotation = step @ rotation

    def rotation(self, frame: str) -> NDArray[np.float64] | None:
        """Rotation (3, 3) from a frame to the body's; None where nothing that is fixed joins them."""
        of_body = dict(self.ancestors(BASE_FRAME))
        return next((of_body[name].T @ rotation for name, rotation in self.ancestors(frame) if name in of_body), None)


class BodyOdometry:
    """Makes the body's odometry of that of any frame that is fixed on the body; places stay those of the sensor.

    Attributes:
        assumed: frames of which no rotation is known: their odometry counts as the body's.

    Parameters:
        rotation_of: rotation (3, 3) from a frame to the body's; None where it is not known.
        wait (s): for how long after its first message odometry of an unknown frame is refused: tf may be late.
    """

    def __init__(self, rotation_of: Callable[[str], NDArray[np.float64] | None], wait: float = 0.0) -> None:
        self._rotation_of, self._wait = rotation_of, wait
        self._first: dict[str, float] = {}
        # Rotation into the body, and that from it as a quaternion; None of frames that are turned as the body is.
        self._turns: dict[str, tuple[NDArray[np.float64], Quaternion] | None] = {}
        self.assumed: set[str] = set()

    def forget(self) -> None:
        """Ask again for the rotations."""
        self._turns.clear()

    def of_body(self, message: Any) -> Any:
        """The body's odometry; the message itself where its frame is the body's, or counts as it.

        Raises ValueError for a stamp that is none and frames without number, and NotYetKnownError while the frame may still
        become known.
        """
        frame = message.child_frame_id.removeprefix('/')
        if frame in ('', BASE_FRAME):
            return message
        if frame not in self._turns and (rotation := self._rotation_of(frame)) is not None:
            same = np.allclose(rotation, np.eye(3))
            self._turns[frame] = None if same else (rotation, inverse(mat2quat(rotation).tolist()))
            self.assumed.discard(frame)
        if frame not in self._turns:
            stamp = to_seconds(message.header.stamp)
            if frame not in self._first and len(self._first) >= MOST_FRAMES:
                raise ValueError(f'odometry of more than {MOST_FRAMES} frames')
            if 0.0 <= stamp - self._first.setdefault(frame, stamp) < self._wait:
                raise NotYetKnownError(f'no fixed transform from {frame!r} to {BASE_FRAME!r} yet')
            self.assumed.add(frame)
            return message
        turn = self._turns[frame]
        return message if turn is None else carried(message, *turn)


def carried(message: Any, rotation: NDArray[np.float64], from_body: Quaternion) -> Odometry:
    """The odometry of the body that carries a sensor, without covariances. Raises ValueError for a stamp that is none.

    Parameters:
        message: odometry of the sensor.
        rotation (3, 3): from the sensor's frame to the body's.
        from_body (w, x, y, z): the inverse.
    """
    header = Header(stamp=to_stamp(to_seconds(message.header.stamp)), frame_id=message.header.frame_id)
    place, linear, angular = message.pose.pose.position, message.twist.twist.linear, message.twist.twist.angular
    attitude = product(attitude_of(message.pose.pose.orientation), from_body)
    return odometry_message(header, BASE_FRAME, (place.x, place.y, place.z), attitude,
                            rotation @ (linear.x, linear.y, linear.z), rotation @ (angular.x, angular.y, angular.z))
