"""Export the thermal detector with its metadata, calibrated on infrared clips (`validation`) and simulated worlds.

`python export_thermal.py CHECKPOINT [CHECKPOINT ...] OUT.onnx --cache FOLDER --data DRONE_DETECTION`. Of several checkpoints
the mean of the weights is exported. Boxes are as labelled: as much wider than the object as the data set's labels are.

Frames of one clip are alike: each clip and each world counts once. Drones of unseen clips score lower than those of known
ones, and few clips do not tell the thresholds near the best apart. Of these the lowest is taken, by the rule of one standard
error (Breiman et al. 1984, sec. 3.4.3), over clips.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from clips import CLASSES
from export import FALSE, SCORE_FUSION, Decoded, candidates, fit, network_of, write
from flight import fit as fit_motion
from flight import paths
from measure import FrameResult, Measurement, detect_all, measure
from network import Network
from numpy.typing import NDArray
from thermal import INPUT, ThermalFrames

from av_vision import Detector, DetectorSettings


def candidates_by_clip(network: Network, args: argparse.Namespace) -> tuple[NDArray, NDArray, NDArray]:
    """Logits (n, classes) of candidates, which of them are drones (n,), and what each counts (n,): all clips alike."""
    parts: list[tuple[NDArray, NDArray, NDArray]] = []
    for split, every in (('validation', 4), ('simulated_validation', 1)):
        frames = ThermalFrames(args.data, args.cache, split)
        for clip in sorted(set(frames.clips)):
            some = [i for i, name in enumerate(frames.clips) if name == clip][::every]
            images = ((np.repeat(frames.image(i)[..., None], 3, axis=2), frames.boxes[i]) for i in some)
            logits, hits = candidates(network, images)
            parts.append((logits, hits, np.full(len(hits), 1.0 / len(some))))
    logits, hits, counts = (np.concatenate(each) for each in zip(*parts, strict=True))
    return logits, hits, counts / counts.mean()


def lowest_threshold(result: Measurement, frames: Sequence[FrameResult]) -> float:
    """The lowest threshold of an F1 within one standard error (over clips) of the best, and half of the false frames allowed.

    Parameters:
        result: what was detected.
        frames: the images it was detected in.
    """
    clip = np.array([frame.clip for frame in frames])
    thresholds = np.arange(0.1, 0.96, 0.01)
    with_drones = result.drones > 0
    mine = [part for name in np.unique(clip) if (part := clip == name)[with_drones].any()]
    others = [part for name in np.unique(clip) if (part := (clip == name) & ~with_drones).any()]

    def found(t: float) -> NDArray[np.float64]:
        """Of each clip with drones: hits, detections and drones."""
        ours = (result.scores >= t) & with_drones[result.frames]
        right = ours & (result.overlaps >= 0.3)
        return np.array([[right[part[result.frames]].sum(), ours[part[result.frames]].sum(), result.drones[part].sum()]
                         for part in mine], float)

    def false(t: float) -> float:
        """Share of the frames without a drone that show one, the mean of clips."""
        wrong = np.zeros(len(clip), bool)
        wrong[result.frames[result.scores >= t]] = True
        return float(np.mean([wrong[part].mean() for part in others]))

    def f1(rows: NDArray) -> float:
        right, ours, there = rows.sum(axis=0)
        return 2.0 * right / max(ours + there, 1.0)

    rows = {t: found(t) for t in thresholds if false(t) < 0.5 * FALSE}
    if not rows:
        return 0.95
    best = max(rows, key=lambda t: f1(rows[t]))
    left_out = [f1(np.delete(rows[best], k, axis=0)) for k in range(len(mine))]  # jackknife
    error = np.sqrt((len(mine) - 1) * np.var(left_out))
    return round(float(min(t for t in rows if f1(rows[t]) >= f1(rows[best]) - error)), 2)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('checkpoints', type=Path, nargs='+', metavar='checkpoint')
    parser.add_argument('out', type=Path)
    parser.add_argument('--cache', type=Path, required=True)
    parser.add_argument('--data', type=Path, required=True)
    args = parser.parse_args()
    torch.set_num_threads(1)
    states = [torch.load(checkpoint, map_location='cpu') for checkpoint in args.checkpoints]
    network = network_of(states)
    logits, hits, counts = candidates_by_clip(network, args)
    weights, shift = fit(logits, hits, counts)
    mixing = weights[0] * np.eye(len(CLASSES))
    mixing[0] = weights
    motion = fit_motion(*(np.array(part) for part in zip(*paths(args.data, 'train', 'IR'), strict=True)), 'IR')
    metadata = {'names': json.dumps(dict(enumerate(CLASSES))), 'task': 'detect', 'imgsz': str(INPUT), 'license': 'Apache-2.0',
                'steps': ' + '.join(str(state['step']) for state in states), 'motion': json.dumps(asdict(motion)),
                'description': 'Thermal drone detector, trained from the visible one; see the model card',
                'score_fusion': json.dumps(asdict(SCORE_FUSION))}
    write(Decoded(network, mixing, shift), args.out, metadata)
    low = Detector(args.out, DetectorSettings(score_threshold=SCORE_FUSION.floor, keep=('drone',), threads=1))
    results = detect_all(low, args.data, 'validation', kind='IR')
    alone, in_time = (measure(results, low, temporal_fusion=fused) for fused in (False, True))
    metadata['score_threshold'] = str(lowest_threshold(alone, results))
    metadata['score_fusion'] = json.dumps(asdict(replace(SCORE_FUSION, threshold=lowest_threshold(in_time, results))))
    write(Decoded(network, mixing, shift), args.out, metadata)
    print(f'{args.out}: {len(hits)} boxes, {hits.sum()} drones, weights {np.round(weights, 3)}, shift {shift:.3f}, {motion}, '
          f'thresholds {metadata["score_threshold"]}, {metadata["score_fusion"]}')
    for name, one in (('alone', alone), ('in time', in_time)):
        for t in (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8):
            print(f'  {name} at {t}: F1 {one.f1(t):.3f}, recall {one.recall(t):.3f}, false {one.false_frames(t):.3f}')


if __name__ == '__main__':
    main()
