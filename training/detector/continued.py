"""Fit what the next box of a track is like (`av_vision.tracking`) to labelled objects of the clips, and print it.

`python continued.py MODEL.onnx --data DRONE_DETECTION [--every 5]` shows the detector the clips as a rig does. A box that hits
the labelled object after one that did continues its track; all others are of other things.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from clips import SPLITS
from measure import FrameResult, detect_all, overlaps_of
from numpy.typing import NDArray
from scipy.optimize import minimize

from av_vision import Detector, DetectorSettings, TemporalDetector
from av_vision.score_fusion import ScoreFusionModel, logit
from av_vision.tracking import BOX, ImageTrack, Tracker

NEAR, ALIKE = 1.5, math.log(3.0)  # sides, and logarithm of the ratio of sizes, within which boxes of other things are counted
Row = tuple[float, float, float, float, float, bool]


def rows_of(results: list[FrameResult], model: ScoreFusionModel) -> Iterator[Row]:
    """What is fitted, of each box that continues a track.

    Gap (s), error of the predicted place (sides), logarithm of the ratio of sizes, difference of the drone's log-odds from the
    track's mean, number of other boxes near it, whether it was seen once.
    """
    clip, followed = '', None
    for result in results:
        if result.clip != clip:
            clip, tracker, followed = result.clip, Tracker(model), None
        seen, labels = result.seen, result.labels
        before = {id(one): (one.predicted(result.time), one.size.max(), result.time - one.time, one.log_odds[0],
                           one.boxes < 2)
                  for one in tracker.tracks}
        tracks = tracker.update(seen, result.time)
        overlap = overlaps_of(seen.boxes.astype(float), labels[:, 1:].astype(float)).max(axis=1, initial=0.0) \
            if len(labels) == 1 else np.zeros(len(seen))
        if not len(seen) or overlap.max() < 0.3:
            followed = followed if len(labels) == 1 else None
            continue
        k = int(overlap.argmax())
        if followed is not None and id(followed) in before:
            place, side, gap, mean, unseen = before[id(followed)]
            apart = np.linalg.norm(seen.centres - place, axis=1) / side
            size = np.log(seen.sizes.max(axis=1) / side)
            others = (apart < NEAR) & (np.abs(size) < ALIKE) & (overlap < 0.3)
            score = float(logit(seen.probabilities[k, 0]) - mean)
            yield gap, float(apart[k]), float(size[k]), score, int(others.sum()), unseen
        followed: ImageTrack | None = tracks[k]


def scales(gap: NDArray, apart: NDArray, size: NDArray, unseen: NDArray) -> NDArray[np.float64]:
    """DRIFT, UNSEEN and RESIZED under which errors of place (n,; sides) and size (n,) after gaps (n,; s) are most likely."""
    def unlikelihood(p: NDArray) -> float:
        drift, first, resized = np.exp(p)
        errors = BOX + np.where(unseen, first, drift) * gap
        off = (apart / errors) ** 2 + (size / resized) ** 2
        return float((2.5 * np.log1p(0.5 * off) + 2.0 * np.log(errors) + math.log(resized)).sum())

    return np.exp(minimize(unlikelihood, [-2.0, 0.0, -3.0], method='Nelder-Mead').x)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('model', type=Path)
    parser.add_argument('--data', type=Path, required=True, help='the drone_detection data set')
    parser.add_argument('--every', type=int, default=5, help='every how manieth clip is used')
    args = parser.parse_args()
    detector = Detector(args.model, DetectorSettings(score_threshold=0.02, keep=('drone',), threads=1))
    results = [one for split in SPLITS for one in detect_all(detector, args.data, split, 2, args.every)]
    rows = np.array(list(rows_of(results, TemporalDetector(detector).model)))
    gap, apart, size, score, others, unseen = rows.T
    print(f'{len(rows)} boxes that continue a track')
    print('DRIFT, UNSEEN, RESIZED: {:.2f}, {:.2f}, {:.3f}'.format(*scales(gap, apart, size, unseen > 0)))
    print(f'SPREAD: {score.std():.1f}; OTHERS: {others.mean() / (math.pi * NEAR**2 * 2.0 * ALIKE):.1e}')


if __name__ == '__main__':
    main()
