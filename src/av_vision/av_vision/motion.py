"""What the path of a track in the image says about its class: an airplane flies straight, a drone seldom does for long.

The centres of the last second and a half are fitted by a parabola (least squares). Its acceleration, in sizes of the object,
tells classes apart: the logarithm of the likelihood ratio is linear in that of the acceleration (logistic regression), and is
used only where it speaks against the class. A track that hardly moves is not judged: a drone may hover.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from av_common.files import shown

HISTORY_S, LEAST_S, LEAST_POINTS = 1.5, 1.0, 6  # of a path that is judged
LEAST_SIZE = 4.0  # pixels, below which boxes are mostly noise
FAINT = 0.1  # sizes/s^2, acceleration that the noise of boxes may give


@dataclass(frozen=True)
class MotionModel:
    """Log-odds of the reported class from the acceleration of a path. Raises ValueError for a value outside its bounds.

    Parameters:
        gain: change of the log-odds for a factor e of the acceleration; 0 ignores the motion.
        neutral (sizes/s^2): acceleration from which on the motion says nothing.
        least_speed (sizes/s): speed below which a path is not judged.
    """

    gain: float = 0.0
    neutral: float = 1.0
    least_speed: float = 0.3

    def __post_init__(self) -> None:
        for name, low, high in (('gain', 0.0, 10.0), ('neutral', FAINT, 100.0), ('least_speed', 0.0, 100.0)):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f'{name} is {getattr(self, name)}, expected {low} to {high}')

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> MotionModel:
        """From `motion` of a detector's metadata, in JSON; without it, motion is ignored. Raises ValueError."""
        text = metadata.get('motion', '{}')
        try:
            return cls(**{name: float(value) for name, value in json.loads(text).items()})
        except (TypeError, AttributeError, ValueError) as error:
            raise ValueError(f'motion is {shown(text)} in the metadata of the detector: {error}') from error

    def log_odds(self, path: Path) -> float:
        """Log-likelihood ratio of the reported class to others, at most 0; 0 for a path that is too short to tell."""
        speed, acceleration = path.motion() if self.gain else (0.0, 0.0)
        if speed < self.least_speed:
            return 0.0
        return min(self.gain * math.log((acceleration + FAINT) / (self.neutral + FAINT)), 0.0)


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

    def motion(self) -> tuple[float, float]:
        """Mean speed in sizes/s and acceleration in sizes/s^2; zeros for a path that is too short."""
        if len(self._points) < LEAST_POINTS or self._points[-1][0] - self._points[0][0] < LEAST_S:
            return 0.0, 0.0
        times = np.array([time for time, _, _ in self._points]) - self._points[0][0]
        centres = np.array([centre for _, centre, _ in self._points])
        return motion_of(times, centres / float(np.median([size for _, _, size in self._points])))


def motion_of(times: NDArray, centres: NDArray) -> tuple[float, float]:
    """Mean speed and acceleration of the parabola that fits centres (n, 2) at times (n,) from 0 s on best."""
    powers = times[:, None] ** np.arange(3)
    (_, velocity, half), *_ = np.linalg.lstsq(powers, centres, rcond=None)
    return float(np.linalg.norm(velocity + half * times[-1])), 2.0 * float(np.linalg.norm(half))
