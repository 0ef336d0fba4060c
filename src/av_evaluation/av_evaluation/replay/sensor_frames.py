"""How sensors are turned on the rig's body, from a bag's /tf_static or the rig's description, and from its gimbal's state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from transforms3d.quaternions import quat2mat

from av_bags.reader import Bag
from av_common.frames import BASE_FRAME, attitude_of
from av_common.gimbal_history import GimbalHistory
from av_common.rig import Rig


class SensorFrames:
    """Rotations (3, 3) of sensor frames into the body's, by name; `unknown` names frames that were asked for in vain.

    Parameters:
        rig: the description.
        gimbal: orientations of the rig's gimbal.
    """

    def __init__(self, rig: Rig, gimbal: GimbalHistory) -> None:
        self._parents: dict[str, tuple[str, NDArray]] = {}
        carrier = rig.gimbal.frame if rig.gimbal else BASE_FRAME
        self._described = {
            rig.array.frame: (BASE_FRAME, rig.array.mount.rotation), BASE_FRAME: (BASE_FRAME, np.eye(3))}
        for camera in rig.cameras.values():
            self._described |= {camera.frame: (carrier, camera.mount.rotation),
                                camera.optical_frame: (carrier, camera.optical_to_body)}
        self._gimbal, self._carrier = gimbal, rig.gimbal.frame if rig.gimbal else ''
        self._known: dict[str, tuple[str, NDArray] | None] = {}
        self.unknown: set[str] = set()

    def learn(self, bag: Bag, topic: str) -> None:
        """Take the transforms of a bag's topic; they go before the rig's description."""
        for _, _, data in bag.messages([topic]):
            for transform in bag.decode(topic, data).transforms:
                q = transform.transform.rotation
                self._parents[transform.child_frame_id] = (transform.header.frame_id, quat2mat(attitude_of(q)))

    def rotation(self, frame: str, time: float) -> NDArray | None:
        """From `frame` to the body at `time` (s); None where neither transforms nor the description know it.

        Raises NotYetKnownError where the gimbal's orientation may still come.
        """
        if frame not in self._known:
            self._known[frame] = self._look_up(frame)
            if self._known[frame] is None:
                self.unknown.add(frame)
        parent, rotation = self._known[frame] or ('', None)
        if rotation is None or parent == BASE_FRAME:
            return rotation
        sample = self._gimbal.at(time)
        return None if sample is None else sample.rotation @ rotation

    def _look_up(self, frame: str) -> tuple[str, NDArray] | None:
        """The body's or the gimbal's frame, and the rotation into it."""
        rotation, at, seen = np.eye(3), frame, set()
        while at in self._parents and at not in (BASE_FRAME, self._carrier) and at not in seen:
            seen.add(at)
            at, step = self._parents[at][0], self._parents[at][1]
            rotation = step @ rotation
        if seen and at in (BASE_FRAME, self._carrier):
            return at, rotation
        return self._described.get(frame)
