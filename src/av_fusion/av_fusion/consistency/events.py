"""What the model of a set-up is told of a moment, and what is told of a rig that is not as described."""

from __future__ import annotations

from typing import NamedTuple

from numpy.typing import NDArray


class SightEvent(NamedTuple):
    """An image in which something is seen.

    Parameters:
        rays: unit vectors (n, 3) in the camera (x along its axis, y left, z up), the best one first.
        view: rotation (3 x 3) of the camera on the body.
        level: rotation (3 x 3) of the body against a level body of the same heading.
        yaws (rad): headings `YAW_DELAYS_S` before its stamp, unwrapped.
        variance (rad^2): of the azimuths.
        half_view (rad): half of the field of view.
    """

    rays: NDArray
    view: NDArray
    level: NDArray
    yaws: NDArray
    variance: float
    half_view: float


class SoundEvent(NamedTuple):
    """A window of sound, by projections of directions on d axes.

    Parameters:
        axes: unit vectors (d, 3) in the body: that of a pair, else across the first direction, and of its horizontal part.
        measured: (n, d) projections of all directions of the window.
        covariance: (d, d) of a projection.
        images (rad): azimuths (2) of the first direction's mirror images in the body.
        elevation (rad): of the first direction above the horizon; NaN of a pair.
        level: as of `SightEvent`.
        yaw (rad): heading.
    """

    axes: NDArray
    measured: NDArray
    covariance: NDArray
    images: NDArray
    elevation: float
    level: NDArray
    yaw: float


class Fault(NamedTuple):
    """What is wrong with the description of the rig.

    Parameters:
        text: what is wrong, with its value.
        mend: where it is mended.
        probability: that the description is wrong.
        is_certain: nothing should move by the bearing.
    """

    text: str
    mend: str
    probability: float
    is_certain: bool

    def __str__(self) -> str:
        return f'{self.text} (probability {min(self.probability, 0.9999):.4f}): {self.mend}'
