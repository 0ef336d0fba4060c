"""How well a detector does on labelled clips."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
from clips import clips_of, film
from numpy.typing import NDArray
from tight import PADDING, padded, tightened, without_padding

from av_vision import Detector, Region, RegionPlanner, TemporalDetector
from av_vision.detections import Candidates

LEAST, BINS = 0.05, 10  # of the calibration error
BANDS = ((5, 8), (8, 12), (12, 20), (20, 40), (40, 80), (80, 160), (160, 300))  # sizes of drones in pixels
Row = tuple[str, str, str]  # of the table: what, the aim, the figure


@dataclass
class Measurement:
    """All detections of a split.

    Of each its score, whether it hit a drone (IoU at least 0.3, each drone once), the IoU, the distance of centres in
    pixels and its frame; of each frame the number of drones in it.
    """

    scores: NDArray[np.float64]
    hits: NDArray[np.bool_]
    overlaps: NDArray[np.float64]
    offsets: NDArray[np.float64]
    frames: NDArray[np.intp]
    drones: NDArray[np.intp]

    def f1(self, threshold: float, overlap: float = 0.3, everywhere: bool = False) -> float:
        """F1 on the frames that show a drone; `everywhere` counts false drones on the other frames against it too."""
        ours = (self.scores >= threshold) & ((self.drones[self.frames] > 0) | everywhere)
        found = np.sum(ours & (self.overlaps >= overlap))
        return 2.0 * found / max(ours.sum() + self.drones.sum(), 1)

    def recall(self, threshold: float, overlap: float = 0.3) -> float:
        """Share of the drones found."""
        return np.sum((self.scores >= threshold) & (self.overlaps >= overlap)) / max(self.drones.sum(), 1)

    def precision(self, threshold: float, overlap: float = 0.3) -> float:
        """Share of the detections, on frames that show a drone, that are right."""
        ours = (self.scores >= threshold) & (self.drones[self.frames] > 0)
        return np.sum(ours & (self.overlaps >= overlap)) / max(ours.sum(), 1)

    def false_frames(self, threshold: float) -> float:
        """Share of the frames without a drone on which one is reported."""
        without = np.flatnonzero(self.drones == 0)
        wrong = np.unique(self.frames[self.scores >= threshold])
        return np.isin(wrong, without).sum() / max(len(without), 1)

    def centred(self, threshold: float, pixels: float = 5.0) -> float:
        """Share of the hits whose centre is within some pixels of the label's."""
        good = self.hits & (self.scores >= threshold)
        return float(np.mean(self.offsets[good] <= pixels)) if good.any() else 0.0

    def average_precision(self, overlap: float = 0.3) -> float:
        """Area under the precision-recall curve over all frames."""
        order = np.argsort(-self.scores)
        right = np.cumsum(self.overlaps[order] >= overlap)
        precision = np.maximum.accumulate((right / np.arange(1, len(right) + 1))[::-1])[::-1]
        return float(np.sum(precision * np.diff(right, prepend=0)) / max(self.drones.sum(), 1))


def calibration_error(scores: NDArray, hits: NDArray) -> float:
    """Expected calibration error (Naeini et al. 2015) of the detections (n,) above LEAST, in BINS of their scores."""
    used = scores >= LEAST
    place = np.clip((scores[used] * BINS).astype(int), 0, BINS - 1)
    gap = np.abs(np.bincount(place, scores[used], BINS) - np.bincount(place, hits[used], BINS))
    return float(gap.sum() / max(used.sum(), 1))


def right_at_half(scores: NDArray, hits: NDArray) -> tuple[float, int]:
    """Share of the detections (n,) scored 0.4 to 0.6 that are right, and their number; NaN without any."""
    some = hits[(scores >= 0.4) & (scores < 0.6)]
    return float(some.mean()) if len(some) else np.nan, len(some)


def overlaps_of(boxes: NDArray, real: NDArray) -> NDArray[np.float64]:
    """IoU (n, k) of boxes (n, 4) with boxes (k, 4)."""
    low, high = np.maximum(boxes[:, None, :2], real[None, :, :2]), np.minimum(boxes[:, None, 2:], real[None, :, 2:])
    area = np.clip(high - low, 0, None).prod(-1)
    return area / (np.prod(boxes[:, 2:] - boxes[:, :2], 1)[:, None] + np.prod(real[:, 2:] - real[:, :2], 1)[None] - area + 1e-9)


def match(boxes: NDArray, real: NDArray) -> tuple[NDArray, NDArray]:
    """IoU with, and distance in pixels to, the drone that each box (in falling order of score) gets; 0 and inf without."""
    overlap, offset = np.zeros(len(boxes)), np.full(len(boxes), np.inf)
    if not len(boxes) or not len(real):
        return overlap, offset
    table = overlaps_of(boxes, real)
    centres, others = boxes[:, :2] + boxes[:, 2:], real[:, :2] + real[:, 2:]
    for k in range(len(boxes)):
        best = int(np.argmax(table[k]))
        if table[k, best] >= 0.1:
            overlap[k], offset[k] = table[k, best], 0.5 * np.linalg.norm(centres[k] - others[best])
            table[:, best] = 0.0
    return overlap, offset


@dataclass
class FrameResult:
    """What a network saw in one image, and what is there: tight boxes (k, 5) of class, x1, y1, x2, y2 and the labels' own.

    `regions` are the parts of the image that it was shown (none: all of it), which took `processor_s` to search.
    """

    clip: str
    time: float
    seen: Candidates
    truth: NDArray[np.float32]
    labels: NDArray[np.float32]
    regions: Sequence[Region] = ()
    processor_s: float = 0.0

    def drones(self, loose: bool = False) -> NDArray[np.float32]:
        """Boxes (k, 4) of the drones that are there, tight or as labelled."""
        some = self.labels if loose else self.truth
        return some[some[:, 0] == 0, 1:]


def detect_all(detector: Detector, data: Path, split: str, regions: int = 0, every: int = 1, kind: str = 'V',
               inverted: bool = False) -> list[FrameResult]:
    """Every third frame of the clips of a split, clip by clip in order, down to the detector's threshold.

    Parameters:
        detector: the detector.
        data: the drone_detection data set.
        split: the clips.
        regions: how many regions of each image are searched, as on a rig; 0: all of it.
        every: every how manieth clip is shown.
        kind: visible (V) or infrared (IR) clips; what infrared labels are around is not known better than they say.
        inverted: whether the clips are shown as negatives (black-hot).
    """
    results = []
    clips = clips_of(data, split, kind)[::every]
    for number, clip in enumerate(clips):
        near = detector.model.near
        planner = RegionPlanner(detector.model.longest, near, regions) if regions and near else None
        temporal = TemporalDetector(detector, planner=planner)
        for time, image, labels in film(data, clip):
            image = 255 - image if inverted else image
            began = process_time()
            seen, searched = temporal.look(image, time)
            temporal.fuse(seen, time, searched)
            truth = tightened(image, labels) if kind == 'V' else labels
            results.append(FrameResult(clip, time, seen, truth, labels, searched, process_time() - began))
        print(f'\r{split}: {number + 1} of {len(clips)} clips, {len(results)} images', end='', file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return results


def measure(results: list[FrameResult], detector: Detector, temporal_fusion: bool = True, loose: bool = False) -> Measurement:
    """What the detector reports: with `temporal_fusion` as on the rig, or each image by itself.

    Its boxes without their padding are compared with tight ones, or `loose`, with the labels' padding, with the labels.
    """
    scores, overlaps, offsets, frames = [], [], [], []
    clip, padding = '', detector.model.box_padding
    for i, result in enumerate(results):
        if result.clip != clip:
            clip, temporal = result.clip, TemporalDetector(detector, temporal_fusion=temporal_fusion)
        found, _ = temporal.fuse(result.seen, result.time, result.regions)
        boxes = without_padding(found.boxes, padding)
        overlap, offset = match(padded(boxes, PADDING) if loose else boxes, result.drones(loose))
        scores.append(found.scores)
        overlaps.append(overlap)
        offsets.append(offset)
        frames.append(np.full(len(found), i))
    overlap = np.concatenate(overlaps)
    return Measurement(np.clip(np.concatenate(scores).astype(float), 1e-6, 1 - 1e-6), overlap >= 0.3, overlap,
                       np.concatenate(offsets), np.concatenate(frames), np.array([len(one.drones()) for one in results]))


def longer_sides(results: list[FrameResult]) -> NDArray[np.float64]:
    """Size in pixels of the drone in each image; NaN where there is not just one."""
    drones = [result.drones() for result in results]
    return np.array([(one[0, 2:] - one[0, :2]).max() if len(one) == 1 else np.nan for one in drones])
