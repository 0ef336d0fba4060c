"""Rotations of frames on each other, fixed or over recent time, from the transforms of tf."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from transforms3d.quaternions import quat2mat

from av_common.frames import BASE_FRAME, attitude_of, is_orientation
from av_common.freshness import FUTURE_S
from av_common.gimbal_history import KEEP_S, RESTART_S, NotYetKnownError
from av_common.quaternions import Quaternion, between
from av_common.stamps import to_seconds
from av_common.timeline import Timeline

LATEST_S = 1.0  # how long before a capture time the newest transform may be for its successor to be waited for
MOST_FRAMES = 500  # of all robots on one tf
Turn = NDArray[np.float64] | Timeline[Quaternion]  # of a frame in its parent: fixed, or over recent time


class FrameTree:
    """The frames of a robot. Nothing that is received can spoil it for good.

    Refused are an ancestor that becomes a child of its descendant, a stamp of the future, a frame that was fixed and now
    moves, frames without number, and numbers that are no pose.
    """

    def __init__(self) -> None:
        self._links: dict[str, tuple[str, Turn]] = {}  # parents of the frames, and how these are turned in them
        self._fixed: dict[str, NDArray[np.float64]] = {}  # what was asked for and does not move
        self._now = -math.inf

    def learn(self, transforms: Iterable[Any], now: float = math.nan) -> dict[str, str]:
        """Take transforms; returns the frames of those that are refused, with the reasons.

        Parameters:
            transforms: of tf.
            now (s): time of their arrival, of frames that move; NaN for fixed ones.
        """
        if math.isnan(now):
            self._fixed.clear()
        else:
            self._begin_again() if now < self._now - RESTART_S else None  # as where a bag begins again
            self._now = now
        refused = {}
        for transform in transforms:
            child, parent = (name.removeprefix('/') for name in (transform.child_frame_id, transform.header.frame_id))
            time = math.nan if math.isnan(now) else to_seconds(transform.header.stamp)
            if problem := self._problem(child, parent, transform.transform, time):
                refused[child] = problem
            else:
                self._add(child, parent, attitude_of(transform.transform.rotation), time)
        return refused

    def _begin_again(self) -> None:
        for _, turn in self._links.values():
            turn.clear() if isinstance(turn, Timeline) else None

    def _add(self, child: str, parent: str, attitude: Quaternion, time: float) -> None:
        if math.isnan(time):
            self._links[child] = parent, quat2mat(attitude)
            return
        before, turn = self._links.get(child, ('', None))
        if before != parent or not isinstance(turn, Timeline):
            turn = Timeline(KEEP_S)
            self._links[child] = parent, turn
        if time > turn.newest:
            turn.add(time, attitude)

    def _problem(self, child: str, parent: str, pose: Any, time: float) -> str:
        """Why a transform cannot be taken, '' where it can; `time` (s) is NaN for a fixed one."""
        if not all(map(math.isfinite, (pose.translation.x, pose.translation.y, pose.translation.z))):
            return 'the translation is not finite'
        if not is_orientation(attitude_of(pose.rotation)):
            return 'the rotation is no unit quaternion'
        if not child or not parent:
            return 'a frame without name'
        if not math.isnan(time) and isinstance(self._links.get(child, ('', None))[1], np.ndarray):
            return 'a fixed frame does not move'
        if time > self._now + FUTURE_S:
            return 'a stamp of the future'
        if child not in self._links and len(self._links) >= MOST_FRAMES:
            return f'more than {MOST_FRAMES} frames'
        return 'a loop' if child in self._above(parent) else ''

    def _above(self, frame: str) -> list[str]:
        """The frame and those that carry it, the nearest first."""
        names = [frame]
        while names[-1] in self._links:
            names.append(self._links[names[-1]][0])
        return names

    def ancestors(self, frame: str, time: float = math.nan) -> Iterator[tuple[str, NDArray[np.float64]]]:
        """The frame and those that carry it, the nearest first, each with the rotation (3, 3) into it.

        Parameters:
            frame: its name.
            time (s): of the rotations, of frames that move.
        """
        rotation = np.eye(3)
        for name in self._above(frame):
            yield name, rotation
            if name in self._links:
                turn = self._links[name][1]
                rotation = (quat2mat(between(*turn.around(time))) if isinstance(turn, Timeline) else turn) @ rotation

    def rotation(self, frame: str, time: float = math.nan, nearest: float = 0.0) -> NDArray[np.float64] | None:
        """Rotation matrix (3, 3) from a frame to the body's, interpolated; None where nothing joins them at that time.

        Parameters:
            frame: its name.
            time (s): for frames that move.
            nearest (s): how long after the newest transform that one is taken.

        Raises NotYetKnownError where a transform of that time may still come.
        """
        if frame in self._fixed:
            return self._fixed[frame]
        up, down = self._above(frame), self._above(BASE_FRAME)
        joint = next((name for name in up if name in down), None)
        if joint is None:
            return None
        turns = [self._links[name][1] for name in (*up[:up.index(joint)], *down[:down.index(joint)])]
        moving = [turn for turn in turns if isinstance(turn, Timeline)]
        if moving:
            newest, oldest = min(turn.newest for turn in moving), max(turn.oldest for turn in moving)
            if nearest < time - newest <= LATEST_S:
                raise NotYetKnownError(f'no transform from {frame!r} to {BASE_FRAME!r} of the capture time yet')
            if not oldest <= time <= newest + nearest:
                return None
            time = min(time, newest)
        of_frame, of_body = (next(rotation for name, rotation in self.ancestors(part, time) if name == joint)
                             for part in (frame, BASE_FRAME))
        rotation = of_body.T @ of_frame
        if not moving:
            self._fixed[frame] = rotation
        return rotation
