"""How sensors are turned on the rig's body, from a bag's /tf_static or from the rig's description."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from transforms3d.quaternions import quat2mat

from av_bags.reader import Bag
from av_common.frames import attitude_of
from av_common.rig import Rig


class SensorFrames:
    """Rotations (3, 3) of sensor frames into the body's, by name; `unknown` names frames that were asked for in vain."""

    def __init__(self, rig: Rig, base_frame: str) -> None:
        self._base = base_frame
        self._parents: dict[str, tuple[str, NDArray]] = {}
        self._described = {rig.array.frame: rig.array.mount.rotation, rig.camera.frame: rig.camera.mount.rotation,
                           rig.camera.optical_frame: rig.camera.optical_to_body, rig.base_frame: np.eye(3)}
        self._known: dict[str, NDArray | None] = {}
        self.unknown: set[str] = set()

    def learn(self, bag: Bag, topic: str) -> None:
        """Take the transforms of a bag's topic; they go before the rig's description."""
        for _, _, data in bag.messages([topic]):
            for transform in bag.decode(topic, data).transforms:
                q = transform.transform.rotation
                self._parents[transform.child_frame_id] = (transform.header.frame_id, quat2mat(attitude_of(q)))

    def rotation(self, frame: str, time: float) -> NDArray | None:
        """From `frame` to the body at `time` (s); None where neither transforms nor the description know it."""
        if frame not in self._known:
            self._known[frame] = self._look_up(frame)
            if self._known[frame] is None:
                self.unknown.add(frame)
        return self._known[frame]

    def _look_up(self, frame: str) -> NDArray | None:
        rotation, at, seen = np.eye(3), frame, set()
        while at in self._parents and at != self._base and at not in seen:
            seen.add(at)
            at, step = self._parents[at][0], self._parents[at][1]
            rotation = step @ rotation
        return rotation if at == self._base and seen else self._described.get(frame)
