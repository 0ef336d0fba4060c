"""How a camera is turned in the world, and where its image goes when it turns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from av_common.camera import PinholeCamera

STEEP = 0.5  # cosine of the elevation beyond which a camera looks up or down
# Degrees, steps in which images are set upright. Of 112 drones of clips that are turned by 0, 10, 20, 30 and 45 degrees the
# detector finds 0.90, 0.85, 0.70, 0.54 and 0.38; half a step costs little, and level flight no turning.
ROLL = 15


@dataclass(frozen=True)
class CameraPose:
    """A camera and its rotation.

    Parameters:
        camera: intrinsics.
        to_body (3, 3): from the optical frame to the rig's body.
        to_world (3, 3): from the optical frame to the world; None where the rig's attitude is not known.
    """

    camera: PinholeCamera
    to_body: NDArray[np.float64]
    to_world: NDArray[np.float64] | None = None

    @property
    def degrees_to_upright(self) -> int:
        """By how many degrees to the left, in steps of ROLL, the image is upright; 0 for a camera that looks up or down.

        Without the rig's attitude the body counts as level.
        """
        right, down, _ = (self.to_body if self.to_world is None else self.to_world)[2]
        level = math.hypot(right, down) > STEEP
        return round(math.degrees(math.atan2(right, -down)) / ROLL) * ROLL % 360 if level else 0


def turned(pixels: NDArray, before: CameraPose, now: CameraPose) -> NDArray[np.float64]:
    """Where distant things at pixels (n, 2) of an image are in the next one; nan for those behind the camera.

    Parameters:
        pixels (n, 2; pixels): places in the image before.
        before, now: pose of the camera in the two images. Without the rig's attitude the body counts as still.
    """
    return now.camera.project(before.camera.rays(pixels) @ _rotation(before, now).T)


def angle_between(before: CameraPose, now: CameraPose) -> float:
    """Angle (rad) by which a camera has turned between two poses. Without the rig's attitude the body counts as still."""
    return math.acos(min(max(0.5 * (float(np.trace(_rotation(before, now))) - 1.0), -1.0), 1.0))


def _rotation(before: CameraPose, now: CameraPose) -> NDArray[np.float64]:
    """Rotation (3, 3) from the optical frame before to that of now."""
    if before.to_world is None or now.to_world is None:
        return now.to_body.T @ before.to_body
    return now.to_world.T @ before.to_world


def pixel_of(vector: ArrayLike, rotation: NDArray[np.float64], camera: PinholeCamera) -> NDArray[np.float64] | None:
    """Where a direction (3,) is in the image (2,), None where it is outside.

    Parameters:
        vector (3,): direction.
        rotation (3, 3): from the optical frame to that of the direction.
        camera: intrinsics.
    """
    pixel = camera.project((rotation.T @ np.asarray(vector, float))[None])[0]
    inside = np.all(pixel >= -0.5) and np.all(pixel <= (camera.width - 0.5, camera.height - 0.5))
    return pixel if inside else None
