"""Numbers for detections that stay with their object from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from av_vision.yolo.detections import Detections


@dataclass
class Track:
    """An object followed in the image: centre and size in pixels, velocity in pixels/s, time last seen in s."""

    id: int
    class_name: str
    centre: NDArray[np.float64]
    size: NDArray[np.float64]
    velocity: NDArray[np.float64]
    time: float

    def predicted(self, time: float) -> NDArray[np.float64]:
        """Centre expected at a time."""
        return self.centre + self.velocity * (time - self.time)


class Tracker:
    """Assigns detections to tracks of constant velocity, by the Hungarian method on distances in units of box sizes.

    A track lives on for `max_gap_s` without being seen. `reach` is how far, in sides of its box and further for each
    second of a gap, an object may be from where it was expected; `reach_px` is the least of it, for tiny objects.
    """

    def __init__(self, max_gap_s: float = 1.0, reach: float = 1.5, reach_px: float = 30.0, smoothing: float = 0.4) -> None:
        self._max_gap_s = max_gap_s
        self._reach = reach
        self._reach_px = reach_px
        self._smoothing = smoothing
        self._tracks: list[Track] = []
        self._next = 1

    def update(self, detections: Detections, time: float) -> list[int]:
        """Track numbers (from 1, never used twice) of detections made at a time in s.

        A time before the last one (a looped file) forgets all tracks.
        """
        if any(time < track.time for track in self._tracks):
            self._tracks = []
        self._tracks = [track for track in self._tracks if time - track.time <= self._max_gap_s]
        ids = [0] * len(detections)
        for row, column in self._assign(detections, time):
            self._follow(self._tracks[row], detections, column, time)
            ids[column] = self._tracks[row].id
        for k, known in enumerate(ids):
            if not known:
                ids[k] = self._begin(detections, k, time)
        return ids

    def _assign(self, detections: Detections, time: float) -> list[tuple[int, int]]:
        if not self._tracks or not len(detections):
            return []
        expected = np.array([track.predicted(time) for track in self._tracks])
        sides = np.array([track.size.max() for track in self._tracks])
        gaps = np.array([time - track.time for track in self._tracks])
        distance = np.linalg.norm(expected[:, None] - detections.centres[None], axis=2)
        cost = distance / (np.maximum(self._reach * sides, self._reach_px) * (1.0 + gaps))[:, None]
        other = np.array([[track.class_name != name for name in detections.class_names] for track in self._tracks])
        cost = np.where(other, np.inf, cost)
        # Out of reach costs more than any number of pairs within, so that it is never taken to save another.
        rows, columns = linear_sum_assignment(np.where(cost <= 1.0, cost, 1e6))
        return [(row, column) for row, column in zip(rows, columns, strict=True) if cost[row, column] <= 1.0]

    def _follow(self, track: Track, detections: Detections, k: int, time: float) -> None:
        centre = detections.centres[k].astype(float)
        if time > track.time:
            moved = (centre - track.centre) / (time - track.time)
            track.velocity += self._smoothing * (moved - track.velocity)
        track.centre, track.size, track.time = centre, detections.sizes[k].astype(float), time

    def _begin(self, detections: Detections, k: int, time: float) -> int:
        track = Track(self._next, detections.class_names[k], detections.centres[k].astype(float),
                      detections.sizes[k].astype(float), np.zeros(2), time)
        self._tracks.append(track)
        self._next += 1
        return track.id
