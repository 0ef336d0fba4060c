"""What the path of a track in the image says about its class: an airplane flies straight, a drone seldom does for long.

The centres of the last second and a half are fitted by a parabola (least squares). Its acceleration, in sizes of the object,
tells classes apart: the logarithm of the likelihood ratio is linear in that of the acceleration (logistic regression), and is
used only where it speaks against the class. A track that hardly moves is not judged: a drone may hover.

A speck is too small for its picture to tell what it is: a hot pixel, a lamp, a leaf or a bit of cloud have good scores, too.
They rest or drift evenly, and their measured acceleration is that of noise (Rayleigh). That of drones has another density
(log-normal, fitted to labelled ones). Where specks mostly rest, one counts as such until a sequential test of the two densities
(Wald 1945) says that it moves as drones do.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from av_common.config_reader import bounded

HISTORY_S, LEAST_S, LEAST_POINTS = 1.5, 1.0, 6  # of a path that is judged
LEAST_SIZE = 4.0  # pixels, below which boxes are mostly noise
FAINT = 0.1  # sizes/s^2, acceleration that the noise of boxes may give
JITTER = 0.3  # pixels, of the centres of boxes: 0.2 to 0.4 about the parabolas of small objects in infrared clips
DECIDED = math.log(0.95 / 0.05)  # log-likelihood ratio at which a sequential test errs in one of twenty, either way


@dataclass(frozen=True)
class MotionModel:
    """Log-odds of the reported class from the acceleration of a path.

    Parameters:
        gain: change of the log-odds for a factor e of the acceleration; 0 ignores the motion.
        neutral (sizes/s^2): acceleration from which on the motion says nothing.
        least_speed (sizes/s): speed below which a path is not judged.
        speck (pixels): size, as a path has it, below which an object is a speck; 0 for none.
        bend (pixels/s^2), bends: median acceleration of drones that are specks, and standard deviation of its logarithm.
        rests (log-odds): of what rests among specks that look like drones.
    """

    gain: float = bounded(0.0, low=0.0, high=10.0)
    neutral: float = bounded(1.0, low=FAINT, high=100.0)
    least_speed: float = bounded(0.3, low=0.0, high=100.0)
    speck: float = bounded(0.0, low=0.0, high=1000.0)
    bend: float = bounded(10.0, low=0.01, high=1e4)
    bends: float = bounded(1.0, low=0.01, high=10.0)
    rests: float = bounded(0.0, low=0.0, high=10.0)

    def log_odds(self, path: Path) -> float:
        """Log-likelihood ratio of the reported class to others, at most 0; 0 for a path that is too short to tell.

        That of specks includes the odds of what rests.
        """
        size, (speed, acceleration, noise) = path.size, path.motion()
        speck = min(max(self.moves(acceleration, noise), -DECIDED) - self.rests, 0.0) if size < self.speck else 0.0
        if speed / size < self.least_speed:
            return speck
        return speck + min(self.gain * math.log((acceleration / size + FAINT) / (self.neutral + FAINT)), 0.0)

    def moves(self, acceleration: float, noise: float) -> float:
        """Log-likelihood ratio of an acceleration being that of a drone to being noise; 0 for none.

        Parameters:
            acceleration (pixels/s^2): of a path.
            noise (pixels/s^2): standard deviation of each component of it.
        """
        if not acceleration > 0.0:
            return 0.0
        drone = -0.5 * (math.log(acceleration / self.bend) / self.bends) ** 2 - math.log(
            math.sqrt(2.0 * math.pi) * self.bends * acceleration)
        rest = math.log(acceleration / noise**2) - 0.5 * (acceleration / noise) ** 2
        return drone - rest


class Path:
    """The last centres of a track in the image."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, NDArray[np.float64], float]] = deque()

    def add(self, time: float, centre: NDArray, size: float) -> None:
        """Add a box.

        Parameters:
            time (s): capture time.
            centre (2,; pixels): its centre.
            size (pixels): larger side of the object.
        """
        self._points.append((time, np.asarray(centre, float), max(size, LEAST_SIZE)))
        while time - self._points[0][0] > HISTORY_S:
            self._points.popleft()

    def turn(self, moved: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> None:
        """Move the path as a rotation of the camera moves the image; what leaves the image is forgotten."""
        if self._points:
            centres = moved(np.array([centre for _, centre, _ in self._points]))
            self._points = deque((time, centre, size) for (time, _, size), centre in zip(self._points, centres, strict=True)
                                 if np.isfinite(centre).all())

    @property
    def size(self) -> float:
        """Median size in pixels; inf for an empty path."""
        return float(np.median([size for _, _, size in self._points])) if self._points else math.inf

    def motion(self) -> tuple[float, float, float]:
        """Mean speed (pixels/s), acceleration and the noise of each of its components (pixels/s^2); zeros for a short path."""
        times, centres = (np.array(part) for part in list(zip(*self._points, strict=True))[:2] or ((), ()))
        # Stamps of whole seconds, for example, repeat.
        if len(np.unique(times)) < LEAST_POINTS or times[-1] - times[0] < LEAST_S:
            return 0.0, 0.0, 0.0
        return motion_of(times - times[0], centres)


def motion_of(times: NDArray, centres: NDArray) -> tuple[float, float, float]:
    """Mean speed and acceleration of the parabola that fits centres (n, 2) at times (n,) from 0 s on best, and its noise.

    The noise is the standard deviation that JITTER, or the centres' distance from the parabola where that is larger, gives each
    component of the acceleration.
    """
    powers = times[:, None] ** np.arange(3)
    fit, *_ = np.linalg.lstsq(powers, centres, rcond=None)
    _, velocity, half = fit
    residual = math.sqrt(np.square(centres - powers @ fit).sum() / (2.0 * (len(times) - 3)))
    noise = 2.0 * math.sqrt(np.linalg.inv(powers.T @ powers)[2, 2]) * max(residual, JITTER)
    return float(np.linalg.norm(velocity + half * times[-1])), 2.0 * float(np.linalg.norm(half)), noise
