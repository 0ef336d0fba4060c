"""What the model of a set-up is told of a moment."""

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
        yaw (rad), yaw_rate (rad/s): heading.
        window (s): length of the window.
    """

    axes: NDArray
    measured: NDArray
    covariance: NDArray
    images: NDArray
    elevation: float
    level: NDArray
    yaw: float
    yaw_rate: float
    window: float
