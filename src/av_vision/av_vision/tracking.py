"""Which box of a picture continues which thing of the pictures before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from av_vision.evidence import STILL, Evidence, EvidenceModel
from av_vision.yolo.detections import Candidates

# Things that no picture gives more than this are not worth a track; weaker boxes may only continue one (Zhang et al. 2022,
# ByteTrack, arXiv:2110.06864).
BEGIN = 0.1
LIKE_SIZE = 3.0   # a box that many times larger or smaller is another thing
SIZE_COST = 0.5   # of a factor e in size, in units of the reach
SCORE_COST = 0.5  # of a box that is nothing rather than surely something


@dataclass
class Track:
    """A thing followed in the image: centre and size in pixels, velocity in pixels/s, time last seen in s, what it may be.

    `id` is 0 until `Tracker.number` gives it one.
    """

    centre: NDArray[np.float64]
    size: NDArray[np.float64]
    velocity: NDArray[np.float64]
    time: float
    evidence: Evidence
    id: int = 0

    def predicted(self, time: float) -> NDArray[np.float64]:
        """Centre expected at a time."""
        return self.centre + self.velocity * (time - self.time)


class Tracker:
    """Assigns boxes to tracks of constant velocity, by the Hungarian method on distances in units of box sizes.

    Classes do not matter for it: what a thing is follows from its track. A track lives on for `max_gap_s` without being
    seen. `reach` is how far, in sides of its box and further for each second of a gap, a thing may be from where it was
    expected; `reach_px` is the least of it, for tiny things.
    """

    def __init__(self, max_gap_s: float = 1.0, model: EvidenceModel = STILL, reach: float = 1.5,
                 reach_px: float = 30.0, smoothing: float = 0.4) -> None:
        self._max_gap_s = max_gap_s
        self._model = model
        self._reach = reach
        self._reach_px = reach_px
        self._smoothing = smoothing
        self._begin = BEGIN if model.memory_s > 0.0 else 0.0
        self._tracks: list[Track] = []
        self._next = 1

    def update(self, seen: Candidates, time: float) -> list[Track | None]:
        """The track of each box seen at a time in s; None for those too weak to begin one.

        A time before the last one (a looped file) forgets all tracks.
        """
        if any(time < track.time for track in self._tracks):
            self.forget()
        self._tracks = [track for track in self._tracks if time - track.time <= self._max_gap_s]
        found: list[Track | None] = [None] * len(seen)
        for row, column in self._assign(seen, time):
            found[column] = self._tracks[row]
        for track in self._tracks:
            if not any(track is one for one in found):
                track.evidence.miss(time)
        for k, track in enumerate(found):
            if track is not None:
                self._follow(track, seen, k, time)
            elif seen.scores[k] >= self._begin:
                found[k] = self._start(seen, k, time)
        return found

    def forget(self) -> None:
        """Begin anew; numbers go on."""
        self._tracks = []

    def number(self, track: Track) -> int:
        """A track's number, from 1, never used twice."""
        if not track.id:
            track.id, self._next = self._next, self._next + 1
        return track.id

    def _assign(self, seen: Candidates, time: float) -> list[tuple[int, int]]:
        if not self._tracks or not len(seen):
            return []
        expected = np.array([track.predicted(time) for track in self._tracks])
        sides = np.array([track.size.max() for track in self._tracks])
        gaps = np.array([time - track.time for track in self._tracks])
        apart = np.linalg.norm(expected[:, None] - seen.centres[None], axis=2)
        apart /= (np.maximum(self._reach * sides, self._reach_px) * (1.0 + gaps))[:, None]
        ratio = np.abs(np.log(np.maximum(seen.sizes.max(axis=1), 1.0)[None] / np.maximum(sides, 1.0)[:, None]))
        possible = (apart <= 1.0) & (ratio <= np.log(LIKE_SIZE))
        # Out of reach costs more than any number of pairs within, so that it is never taken to save another.
        cost = np.where(possible, apart + SIZE_COST * ratio - SCORE_COST * seen.scores[None], 1e6)
        rows, columns = linear_sum_assignment(cost)
        return [(row, column) for row, column in zip(rows, columns, strict=True) if possible[row, column]]

    def _follow(self, track: Track, seen: Candidates, k: int, time: float) -> None:
        centre = seen.centres[k].astype(float)
        if time > track.time:
            moved = (centre - track.centre) / (time - track.time)
            track.velocity += self._smoothing * (moved - track.velocity)
        track.centre, track.size, track.time = centre, seen.sizes[k].astype(float), time
        track.evidence.add(seen.probabilities[k], time)

    def _start(self, seen: Candidates, k: int, time: float) -> Track:
        evidence = Evidence(self._model, seen.probabilities.shape[1])
        evidence.add(seen.probabilities[k], time)
        track = Track(seen.centres[k].astype(float), seen.sizes[k].astype(float), np.zeros(2), time, evidence)
        self._tracks.append(track)
        return track
