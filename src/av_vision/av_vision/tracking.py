"""Tracking of boxes in the image from one image to the next.

Whether a box is the next one of a track: its odds are the density of what the track, which predicts where its object is, how
large and of which class, would give, times what the box's own scores say, over the density of boxes of other things (Bar-Shalom
and Li 1995, sec. 2.5; scores as in Blackman and Popoli 1999, sec. 6.2). Lengths are in sides of the track's box, so that they
hold for near and far objects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.special import expit

from av_vision.detections import Candidates
from av_vision.motion import Path
from av_vision.score_fusion import SINGLE_IMAGE, ScoreFusionModel, logit

# A candidate below this score can continue a track, but not begin one (Zhang et al. 2022, ByteTrack, arXiv:2110.06864).
BEGIN = 0.1
MAX_GAP_S = 1.0  # for which a track is kept without a detection
SMOOTHING_S = 0.15  # time constant of the velocity: of two images of a high rate it would be the noise of their boxes
# Errors of predicted place and size have Student's t density of two degrees of freedom, in three dimensions: most are small,
# some many times larger, as objects turn, are seen for the first time, and cameras shake.
STUDENT = math.lgamma(2.5) - 1.5 * math.log(2.0 * math.pi)
# Fitted by training/detector/continued.py to boxes that continue labelled drones, birds and aircraft.
BOX = 0.02                       # sides, scale of the errors of places at any pace: those clips' camera stands still
DRIFT, UNSEEN = 0.11, 0.7        # sides/s, with which it grows; of an object that was seen once
RESIZED = 0.027                  # of the logarithm of the size
SPREAD = 2.1                     # log-odds, of the scores of one object about their mean
OTHERS = 7.6e-4                  # boxes of other things per square side and e-fold of size, for each of the object
LEAST_SIDE = 16.0                # pixels; boxes of smaller objects are as uncertain


def log_odds(tracks: Sequence[ImageTrack], candidates: Candidates, time: float, prior: float) -> NDArray[np.float64]:
    """Log-odds (tracks, candidates) that each candidate is the track's object.

    Parameters:
        tracks: the tracks.
        candidates: the boxes of an image.
        time (s): its capture time.
        prior (log-odds): of a class among all candidates.
    """
    expected = np.array([track.predicted(time) for track in tracks])
    sides = np.maximum([track.size.max() for track in tracks], LEAST_SIDE)
    errors = BOX + np.array([(DRIFT if track.boxes > 1 else UNSEEN) * (time - track.time) for track in tracks])
    apart = np.linalg.norm(expected[:, None] - candidates.centres[None], axis=2) / sides[:, None]
    before, now = (np.maximum(size, 1.0) for size in ([track.size.max() for track in tracks], candidates.sizes.max(axis=1)))
    off = (apart / errors[:, None]) ** 2 + (np.log(now[None] / before[:, None]) / RESIZED) ** 2
    alike = STUDENT - 2.5 * np.log1p(0.5 * off) - np.log(errors**2 * RESIZED)[:, None]
    return alike + scores(tracks, candidates, prior) - math.log(OTHERS)


def scores(tracks: Sequence[ImageTrack], candidates: Candidates, prior: float) -> NDArray[np.float64]:
    """Log-likelihood ratio (tracks, candidates) of the boxes' own scores, of the classes that track and box most likely are.

    Those of one object spread about their mean; those of all boxes are normal about two means that are their variance apart,
    as calibrated scores are (see `score_fusion`). Scores far below those of other things say no more than these.
    """
    variance, share = SPREAD**2, 1.0 / (1.0 + np.exp(-prior))
    least = prior - 0.5 * variance - SPREAD
    means = np.maximum([track.log_odds for track in tracks], least)
    own = np.maximum(logit(candidates.probabilities), least)
    same = -0.5 * (own[None] - means[:, None]) ** 2 / variance
    other = np.logaddexp(np.log(1.0 - share) - 0.5 * (own - prior + 0.5 * variance) ** 2 / variance,
                         np.log(share) - 0.5 * (own - prior - 0.5 * variance) ** 2 / variance)
    ratio = same - other[None]
    of_track, of_box = means.argmax(axis=1), own.argmax(axis=1)
    by_track = np.take_along_axis(ratio, of_track[:, None, None], axis=2)[..., 0]
    by_box = np.take_along_axis(ratio, of_box[None, :, None], axis=2)[..., 0]
    return by_track + np.where(of_track[:, None] == of_box[None], 0.0, by_box)


@dataclass
class ImageTrack:
    """State of an object that is tracked in the image.

    Parameters:
        centre (2,; pixels): centre of the last box.
        size (2,; pixels): width and height of the last box.
        velocity (2,; pixels/s): velocity of the centre.
        time (s): capture time of the last box.
        log_odds (classes,): mean of those of its boxes, weighted by age.
        weight: sum of the weights.
        looked (s): capture time of the last image that was searched for it.
        path: where it was, for what its motion says.
        boxes: number of images in which it was found.
        continued (0-1): probability that the last box is its object.
        id: 0 until `Tracker.number` assigns one.
    """

    centre: NDArray[np.float64]
    size: NDArray[np.float64]
    velocity: NDArray[np.float64]
    time: float
    log_odds: NDArray[np.float64]
    weight: float = 0.0
    looked: float = -np.inf
    path: Path = field(default_factory=Path)
    boxes: int = 0
    continued: float = 1.0
    id: int = 0

    @property
    def probabilities(self) -> NDArray[np.float64]:
        """Posterior probabilities (classes,)."""
        return np.asarray(expit(self.log_odds))

    def predicted(self, time: float) -> NDArray[np.float64]:
        """Centre (2,) in pixels expected at `time` (s)."""
        return self.centre + self.velocity * (time - self.time)


class Tracker:
    """Assigns boxes to tracks of constant velocity, by the Hungarian method on `log_odds`.

    A box that is more likely something else continues no track, which was missed then.

    Attributes:
        tracks: those that may go on.

    Parameters:
        model: statistics of the scores of a track.
    """

    def __init__(self, model: ScoreFusionModel = SINGLE_IMAGE) -> None:
        self._model = model
        self._begin = BEGIN if model.memory_s > 0.0 else 0.0
        self.tracks: list[ImageTrack] = []
        self._numbers = count(1)

    def turn(self, moved: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> None:
        """Move the tracks as a rotation of the camera moves the image.

        Parameters:
            moved: where pixels (n, 2) of the last image are in the next one; nan for those outside.
        """
        if self.tracks:
            centres = moved(np.array([track.centre for track in self.tracks]))
            for track, centre in zip(self.tracks, centres, strict=True):
                track.centre = centre
                track.path.turn(moved)
            self.tracks = [track for track in self.tracks if np.isfinite(track.centre).all()]

    def update(self, candidates: Candidates, time: float) -> list[ImageTrack | None]:
        """The track of each candidate; None for candidates of too low score to begin one.

        Parameters:
            candidates: candidates of one image.
            time (s): time of capture; a time before the last one (a looped file) discards all tracks.
        """
        if any(time < track.time for track in self.tracks):
            self.reset()
        self.tracks = [track for track in self.tracks if time - track.time <= MAX_GAP_S]
        found: list[ImageTrack | None] = [None] * len(candidates)
        if self.tracks and len(candidates):
            # A pair that does not belong together is worth what a track without a box is.
            odds = np.maximum(log_odds(self.tracks, candidates, time, self._model.prior), 0.0)
            for row, column in zip(*linear_sum_assignment(odds, maximize=True), strict=True):
                if odds[row, column] > 0.0:
                    found[column] = self.tracks[row]
                    self.tracks[row].continued = float(expit(odds[row, column]))
        for k, (centre, size) in enumerate(zip(candidates.centres, candidates.sizes, strict=True)):
            track = found[k]
            if track is None and candidates.scores[k] >= self._begin:
                track = found[k] = ImageTrack(centre, size, np.zeros(2), time, np.zeros(candidates.probabilities.shape[1]))
                self.tracks.append(track)
            elif track is not None and time > track.time:
                newest = (centre - track.centre) / (time - track.time)
                track.velocity += (1.0 - math.exp((track.time - time) / SMOOTHING_S)) * (newest - track.velocity)
            if track is not None:
                kept = math.exp((track.time - time) / self._model.memory_s) if self._model.memory_s > 0.0 else 0.0
                track.weight = kept * track.weight + 1.0
                track.log_odds += (logit(candidates.probabilities[k]) - track.log_odds) / track.weight
                track.centre, track.size, track.time = centre.astype(float), size.astype(float), time
                track.boxes += 1
        return found

    def reset(self) -> None:
        """Discard all tracks; numbers continue."""
        self.tracks = []

    def number(self, track: ImageTrack) -> int:
        """The number of a track, from 1, never used twice."""
        track.id = track.id or next(self._numbers)
        return track.id
