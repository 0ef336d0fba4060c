"""Tracking of boxes in the image from one image to the next."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from av_vision.continuation import log_odds
from av_vision.detections import Candidates
from av_vision.motion import Path
from av_vision.score_fusion import SINGLE_IMAGE, ScoreFusion, ScoreFusionModel

# A candidate below this score can continue a track, but not begin one (Zhang et al. 2022, ByteTrack, arXiv:2110.06864).
BEGIN = 0.1
SMOOTHING = 0.4  # weight of the newest velocity
IMPOSSIBLE = 1e6  # more than any log-odds, so that such a pair is never selected instead of possible ones


@dataclass
class ImageTrack:
    """State of an object that is tracked in the image.

    Parameters:
        centre (2,; pixels): centre of the last box.
        size (2,; pixels): width and height of the last box.
        velocity (2,; pixels/s): velocity of the centre.
        time (s): capture time of the last box.
        scores: posterior of the classes.
        looked (s): capture time of the last image that was searched for it.
        path: where it was, for what its motion says.
        boxes, missed: numbers of images in which it was found, and looked for in vain.
        continued (0-1): probability that the last box is its object.
        id: 0 until `Tracker.number` assigns one.
    """

    centre: NDArray[np.float64]
    size: NDArray[np.float64]
    velocity: NDArray[np.float64]
    time: float
    scores: ScoreFusion
    looked: float = -np.inf
    path: Path = field(default_factory=Path)
    boxes: int = 1
    missed: int = 0
    continued: float = 1.0
    id: int = 0

    def predicted(self, time: float) -> NDArray[np.float64]:
        """Centre (2,) in pixels expected at `time` (s)."""
        return self.centre + self.velocity * (time - self.time)


class Tracker:
    """Assigns boxes to tracks of constant velocity, by the Hungarian method on the log-odds of `continuation`.

    A box that is more likely something else continues no track, which was missed then.

    Parameters:
        max_gap_s (s): time for which a track is kept without a detection.
        model: statistics of the scores of a track.
    """

    def __init__(self, max_gap_s: float = 1.0, model: ScoreFusionModel = SINGLE_IMAGE) -> None:
        self._max_gap_s = max_gap_s
        self._model = model
        self._begin = BEGIN if model.memory_s > 0.0 else 0.0
        self._tracks: list[ImageTrack] = []
        self._next = 1

    @property
    def tracks(self) -> tuple[ImageTrack, ...]:
        """The tracks."""
        return tuple(self._tracks)

    def turn(self, moved: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> None:
        """Move the tracks as a rotation of the camera moves the image.

        Parameters:
            moved: where pixels (n, 2) of the last image are in the next one; nan for those outside.
        """
        if self._tracks:
            centres = moved(np.array([track.centre for track in self._tracks]))
            for track, centre in zip(self._tracks, centres, strict=True):
                track.centre = centre
                track.path.turn(moved)
            self._tracks = [track for track in self._tracks if np.isfinite(track.centre).all()]

    def update(self, candidates: Candidates, time: float,
               searched: Callable[[ImageTrack], bool] = lambda _: True) -> list[ImageTrack | None]:
        """The track of each candidate; None for candidates of too low score to begin one.

        Parameters:
            candidates: candidates of one image.
            time (s): time of capture; a time before the last one (a looped file) discards all tracks.
            searched: whether a track would have been found in this image, so that its absence tells something.
        """
        if any(time < track.time for track in self._tracks):
            self.reset()
        self._tracks = [track for track in self._tracks if time - track.time <= self._max_gap_s]
        found: list[ImageTrack | None] = [None] * len(candidates)
        odds = self._assign(candidates, time)
        for row, column in odds:
            found[column] = self._tracks[row]
            self._tracks[row].continued = 1.0 / (1.0 + math.exp(-odds[row, column]))
        for track in self._tracks:
            if not any(track is one for one in found) and searched(track):
                track.missed += 1
                track.scores.miss(time)
        for k, assigned in enumerate(found):
            if assigned is not None:
                self._follow(assigned, candidates, k, time)
            elif candidates.scores[k] >= self._begin:
                found[k] = self._start(candidates, k, time)
        return found

    def reset(self) -> None:
        """Discard all tracks; numbers continue."""
        self._tracks = []

    def number(self, track: ImageTrack) -> int:
        """The number of a track, from 1, never used twice."""
        if not track.id:
            track.id, self._next = self._next, self._next + 1
        return track.id

    def _assign(self, candidates: Candidates, time: float) -> dict[tuple[int, int], float]:
        """Log-odds of the pairs of a track and a candidate that belong together."""
        if not self._tracks or not len(candidates):
            return {}
        odds = log_odds(self._tracks, candidates, time, self._model.prior)
        rows, columns = linear_sum_assignment(np.where(odds > 0.0, -odds, IMPOSSIBLE))
        return {(row, column): float(odds[row, column])
                for row, column in zip(rows.tolist(), columns.tolist(), strict=True) if odds[row, column] > 0.0}

    def _follow(self, track: ImageTrack, candidates: Candidates, k: int, time: float) -> None:
        centre = candidates.centres[k].astype(float)
        if time > track.time:
            moved = (centre - track.centre) / (time - track.time)
            track.velocity += SMOOTHING * (moved - track.velocity)
        track.boxes += 1
        track.centre, track.size, track.time = centre, candidates.sizes[k].astype(float), time
        track.scores.add(candidates.probabilities[k], time)

    def _start(self, candidates: Candidates, k: int, time: float) -> ImageTrack:
        scores = ScoreFusion(self._model, candidates.probabilities.shape[1])
        scores.add(candidates.probabilities[k], time)
        track = ImageTrack(candidates.centres[k].astype(float), candidates.sizes[k].astype(float), np.zeros(2), time, scores)
        self._tracks.append(track)
        return track
