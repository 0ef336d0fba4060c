"""Looks of a camera on a gimbal, from the components of the posterior and the rig's attitude."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from av_common.rig import GimbalMount
from av_fusion.disambiguation.look import LookPlanner, Place, Sight
from av_fusion.measurement.measurements import CameraMeasurement
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import angles, turned_back
from av_fusion.tracks.component import GaussianComponent

NEWEST_IMAGE_S = 1.0  # age from which the camera counts as absent


class CameraLooks:
    """Asks for looks in the body's frame.

    Attributes:
        planner: plans looks for a target in the world.

    Parameters:
        gimbal: carries the camera.
    """

    def __init__(self, gimbal: GimbalMount) -> None:
        self.planner = LookPlanner(gimbal)
        self._gimbal = gimbal
        self._sight: Sight | None = None

    def on_image(self, time: float, image: CameraMeasurement, motion: RigMotion, shows_target: bool) -> None:
        """Note where the camera looked.

        Parameters:
            time (s): capture time.
            image: the measurement.
            motion: of the rig.
            shows_target: whether the target was seen.
        """
        camera = np.array(motion.attitude(time)) @ np.array(image.view)
        self._sight = Sight(time, camera, image.half_view, image.half_height)
        if not shows_target:
            self.planner.see(self._sight)

    def plan(self, time: float, components: Sequence[GaussianComponent], visible: float, motion: RigMotion
             ) -> tuple[float, float] | None:
        """Azimuth and elevation (rad) in the body's frame to look at; None when no look is requested.

        Parameters:
            time (s): time of the request.
            components: possible directions of the target.
            visible: probability that the camera finds a target at which it looks.
            motion: of the rig.
        """
        return _in_body(self.planner.plan(time, lambda: [_place(component, visible) for component in components],
                                          self._newest(time), self._mount(time, motion)), time, motion)

    def _newest(self, time: float) -> Sight | None:
        return self._sight if self._sight is not None and abs(time - self._sight.time) <= NEWEST_IMAGE_S else None

    def _mount(self, time: float, motion: RigMotion) -> NDArray[np.float64]:
        """Rotation matrix (3, 3) from the gimbal's mount to the world."""
        if not self._gimbal.stabilized:
            return np.array(motion.attitude(time)) @ self._gimbal.mount.rotation
        yaw = motion.yaw(time)
        heading = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        return heading @ self._gimbal.mount.rotation


def _in_body(look: NDArray[np.float64] | None, time: float, motion: RigMotion) -> tuple[float, float] | None:
    if look is None:
        return None
    x, y, z = look.tolist()
    return angles(turned_back(motion.attitude(time), (x, y, z)))


def _place(component: GaussianComponent, visible: float) -> Place:
    (across, _), (_, up) = component.covariance[:2, :2].tolist()
    return Place(component.azimuth, component.elevation, across, up, component.weight, visible,
                 component.across_rate / max(math.cos(component.elevation), 0.2))
