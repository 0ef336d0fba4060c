"""How well a detector does on other people's pictures, each by itself."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from measure import match, overlaps_of
from numpy.typing import NDArray
from places import Place, pictures
from tight import without_padding

from av_vision import Detector

SHARES = (0.0, 0.1, 0.25, 0.5, np.inf)  # of the picture's longer side
TOUCHES = 0.1  # IoU from which a box is a bad one of a drone rather than a false drone


@dataclass
class Elsewhere:
    """Some pictures: of each drone in them its share of the picture and the score of the box that hits it (0 for none).

    Further of each box its score and whether it hits, and of each picture the highest score of a box that touches no drone
    (0 for none), the number of drones, and whether it shows something without a class, a balloon.
    """

    shares: NDArray[np.float64]
    found: NDArray[np.float64]
    scores: NDArray[np.float64]
    hits: NDArray[np.bool_]
    false: NDArray[np.float64]
    drones: NDArray[np.intp]
    nameless: NDArray[np.bool_]

    def recall(self, threshold: float, low: float = 0.0, high: float = np.inf) -> float:
        """Share of the drones found of those that take some share of their picture; NaN when there are none."""
        some = self.found[(self.shares >= low) & (self.shares < high)]
        return float(np.mean(some >= threshold)) if len(some) else np.nan

    def false_pictures(self, threshold: float, some: NDArray[np.bool_] | None = None) -> float:
        """Share of the pictures, or of some of them, in which a drone is reported where there is none."""
        return float(np.mean((self.false if some is None else self.false[some]) >= threshold))


def together(parts: list[Elsewhere]) -> Elsewhere:
    """The pictures of some places as one."""
    names = Elsewhere.__dataclass_fields__
    return Elsewhere(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def look_at(detector: Detector, place: Place, cache: Path, count: int) -> Elsewhere:
    """Show a detector `count` pictures of a place, the same for every detector, down to its threshold."""
    there = list(pictures(place, cache))
    chosen = np.random.default_rng(0).permutation(len(there))[:count]
    shares, found, scores, hits, false, drones = [], [], [], [], [], []
    for number, i in enumerate(chosen):
        image, truth = there[i].load()
        real = truth[truth[:, 0] == 0, 1:]
        seen = detector.detect(image)
        boxes = without_padding(seen.boxes, detector.model.box_padding)
        right = match(boxes, real)[0] >= 0.3
        table = overlaps_of(boxes, real) if len(boxes) and len(real) else np.zeros((len(boxes), max(len(real), 1)))
        best = table.max(axis=1)
        shares.append((real[:, 2:] - real[:, :2]).max(axis=1, initial=0.0) / max(image.shape[:2]))
        hit = np.where(right[:, None] & (table >= 0.3), seen.scores[:, None], 0.0)
        found.append(hit.max(axis=0, initial=0.0)[:len(real)])
        scores.append(seen.scores)
        hits.append(right)
        false.append(seen.scores[best < TOUCHES].max(initial=0.0))
        drones.append(len(real))
        if number % 20 == 19:
            print(f'\r{place.name}: {number + 1} of {len(chosen)} pictures', end='', file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return Elsewhere(np.concatenate(shares), np.concatenate(found), np.concatenate(scores).astype(float), np.concatenate(hits),
                     np.array(false), np.array(drones), np.array([there[i].nameless for i in chosen], bool))
