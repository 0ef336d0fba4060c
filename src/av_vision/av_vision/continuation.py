"""Whether a box of an image is the next one of a track: odds against what else gives boxes.

A track predicts where its object is, how large and of which class. The odds are the density of what the track would give, times
what the box's own scores say, over the density of boxes of other things (Bar-Shalom and Li 1995, sec. 2.5; scores as in
Blackman and Popoli 1999, sec. 6.2). Lengths are in sides of the track's box, so that they hold for near and far objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from av_vision.detections import Candidates
from av_vision.score_fusion import logit

if TYPE_CHECKING:
    from av_vision.tracking import ImageTrack

# Fitted by training/detector/continued.py to 1,354 boxes that continue labelled drones, birds and aircraft of 26 clips.
STEADY, TURNING = 0.29, 0.81     # sides/s, error of the predicted velocity, and of that of an object that turns ...
TURNS = 0.40                     # ... which is so often
UNSEEN = 2.2                     # sides/s, speed of an object that was seen once
SIZE, RESIZED, RESIZES = 0.025, 0.16, 0.15  # of the logarithm of the size; of an object that turns, and how often
FOUND = 0.85                     # probability that an object gives a box, before its track tells; counts as one image
SPREAD = 2.1                     # log-odds, of the scores of one object about their mean
OTHERS = 7.6e-4                  # boxes of other things per square side and e-fold of size, where there is a target
# Not in those clips, whose camera stands still:
BOX = 0.02                       # sides, jitter of a box at any pace
SHAKEN, SHAKE = 0.02, 0.75       # how often, and by how many sides, a camera shakes that tells no pose
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
    gaps = np.array([time - track.time for track in tracks])
    rates = np.array([(UNSEEN, UNSEEN) if track.boxes < 2 else (STEADY, TURNING) for track in tracks]).T
    apart = np.linalg.norm(expected[:, None] - candidates.centres[None], axis=2) / sides[:, None]
    steady, turning = (BOX + rate * gaps for rate in rates)
    place = np.log((1.0 - TURNS - SHAKEN) * normal(apart, steady) + TURNS * normal(apart, turning)
                   + SHAKEN * normal(apart, SHAKE + turning) + 1e-300)
    before, now = (np.maximum(size, 1.0) for size in ([track.size.max() for track in tracks], candidates.sizes.max(axis=1)))
    resized = np.log(now[None] / before[:, None])
    size = np.log(sum(share * np.exp(-0.5 * (resized / sigma) ** 2) / (np.sqrt(2.0 * np.pi) * sigma)
                      for share, sigma in ((1.0 - RESIZES, SIZE), (RESIZES, RESIZED))) + 1e-300)
    found = np.array([(track.boxes + FOUND) / (track.boxes + track.missed + 1.0) for track in tracks])
    return place + size + scores(tracks, candidates, prior) + np.log(found / OTHERS)[:, None]


def normal(apart: NDArray[np.float64], sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    """Density in the plane at distances (tracks, candidates) for standard deviations (tracks,)."""
    return np.exp(-0.5 * (apart / sigma[:, None]) ** 2) / (2.0 * np.pi * sigma[:, None] ** 2)


def scores(tracks: Sequence[ImageTrack], candidates: Candidates, prior: float) -> NDArray[np.float64]:
    """Log-likelihood ratio (tracks, candidates) of the boxes' own scores, of the classes that track and box most likely are.

    Those of one object spread about their mean; those of all boxes are normal about two means that are their variance apart,
    as calibrated scores are (see `score_fusion`). Scores far below those of other things say no more than these.
    """
    variance, share = SPREAD**2, 1.0 / (1.0 + np.exp(-prior))
    least = prior - 0.5 * variance - SPREAD
    means = np.maximum([track.scores.mean for track in tracks], least)
    own = np.maximum(logit(candidates.probabilities), least)
    same = -0.5 * (own[None] - means[:, None]) ** 2 / variance
    other = np.logaddexp(np.log(1.0 - share) - 0.5 * (own - prior + 0.5 * variance) ** 2 / variance,
                         np.log(share) - 0.5 * (own - prior - 0.5 * variance) ** 2 / variance)
    ratio = same - other[None]
    of_track, of_box = means.argmax(axis=1), own.argmax(axis=1)
    by_track = np.take_along_axis(ratio, of_track[:, None, None], axis=2)[..., 0]
    by_box = np.take_along_axis(ratio, of_box[None, :, None], axis=2)[..., 0]
    return by_track + np.where(of_track[:, None] == of_box[None], 0.0, by_box)
