"""Fit the second look: how much the near network's answer counts beside that of the first (`av_vision.yolo.second_look`).

`python second.py MODEL.onnx NEAR.onnx --data DRONE_DETECTION` writes it, the near network's name and a threshold into the
metadata of MODEL. All comes from the clips of the split `validation` as a rig searches them: neither network was trained on
them. Logistic regression on the log-odds of both.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
from clips import clips_of, film
from measure import Measurement, detect_all, match, measure
from numpy.typing import NDArray
from scipy.optimize import minimize
from tight import tightened, without_padding

from av_vision.detections import Candidates
from av_vision.score_fusion import logit
from av_vision.search import RegionPlanner
from av_vision.temporal_detector import TemporalDetector
from av_vision.yolo import Detector, DetectorSettings

REGIONS = 2
FALSE = 0.02  # share of images without a drone that may show one: places that no clip shows have more of them
LOW = DetectorSettings(score_threshold=0.02, keep=('drone',), threads=1)


def seen_twice(detector: Detector, data: Path, split: str) -> Iterator[tuple[NDArray, NDArray, NDArray]]:
    """Of the candidates in each image that get a second look: both networks' probabilities (n,) and whether it is a drone."""
    for clip in clips_of(data, split):
        temporal = TemporalDetector(detector, planner=RegionPlanner(detector.model.longest, detector.model.near, REGIONS))
        for time, image, labels in film(data, clip):
            seen, regions = temporal.look(image, time)
            temporal.fuse(seen, time, regions)
            some = detector.small(seen, image.shape)
            if len(some):
                found = Candidates(seen.boxes[some], seen.probabilities[some])
                second = detector.second_probabilities(image, found)
                truth = tightened(image, labels)
                boxes = without_padding(found.boxes, detector.model.box_padding)
                hits = match(boxes, truth[truth[:, 0] == 0, 1:])[0] >= 0.3
                yield found.probabilities[:, 0], second[:, 0], hits


def fit(first: NDArray, second: NDArray, hits: NDArray) -> list[float]:
    """Gain, weight and shift of the log-odds of both networks (n,) that make the hits (n,) most likely."""
    odds = np.stack([logit(first), logit(second), np.ones(len(hits))], axis=1)

    def unlikelihood(x: NDArray) -> float:
        return float(np.sum(np.logaddexp(0.0, odds @ x) - hits * (odds @ x)) + 0.1 * x[:2] @ x[:2])

    found = minimize(unlikelihood, [1.0, 0.0, 0.0], bounds=[(0.01, 20.0), (0.0, 20.0), (-20.0, 20.0)], method='L-BFGS-B').x
    return [round(float(one), 3) for one in found]


def choose_threshold(result: Measurement) -> float:
    """That of the best F1 of those at which fewer than FALSE of the images without a drone show one."""
    allowed = [t for t in np.arange(0.1, 0.96, 0.01) if result.false_frames(t) < FALSE]
    return round(float(max(allowed, key=result.f1, default=0.95)), 2)


def write_metadata(path: Path, **values: str) -> None:
    """Add values to the metadata of a model, or take away those that are empty."""
    model = onnx.load(str(path))
    metadata = {one.key: one.value for one in model.metadata_props} | values
    onnx.helper.set_model_props(model, {key: value for key, value in metadata.items() if value})
    onnx.save(model, str(path))


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('model', type=Path)
    parser.add_argument('near', type=Path, help='the near network, a file beside the model')
    parser.add_argument('--data', type=Path, required=True)
    args = parser.parse_args()
    write_metadata(args.model, near_model=args.near.name, second_look='')
    parts = zip(*seen_twice(Detector(args.model, LOW), args.data, 'validation'), strict=True)
    first, second, hits = (np.concatenate(part) for part in parts)
    combination = fit(first, second, hits)
    write_metadata(args.model, second_look=json.dumps(combination))
    detector = Detector(args.model, replace(LOW, score_threshold=0.02))
    result = measure(detect_all(detector, args.data, 'validation', REGIONS), detector)
    threshold = choose_threshold(result)
    write_metadata(args.model, score_threshold=str(threshold))
    print(f'{len(hits)} candidates, {hits.sum()} drones: gain, weight, shift {combination}, threshold {threshold}: '
          f'F1 {result.f1(threshold):.3f}, false frames {result.false_frames(threshold):.3f}')


if __name__ == '__main__':
    main()
