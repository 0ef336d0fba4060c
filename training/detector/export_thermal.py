"""Export the thermal detector, calibrated and with its metadata, from the split `validation` of the infrared clips.

`python export_thermal.py CHECKPOINT [CHECKPOINT ...] OUT.onnx --cache FOLDER --data DRONE_DETECTION`. Of several checkpoints
the mean of the weights is exported. Boxes are as labelled: as much wider than the object as the data set's labels are.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from clips import CLASSES
from export import FALSE, SCORE_FUSION, Decoded, candidates, choose_threshold, fit, network_of, write
from flight import fit as fit_motion
from flight import paths
from measure import detect_all, measure
from thermal import INPUT, ThermalFrames

from av_vision.motion import MotionModel
from av_vision.yolo import Detector, DetectorSettings


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
    network, frames = network_of(states), ThermalFrames(args.data, args.cache, 'validation')
    images = ((np.repeat(frames.image(i)[..., None], 3, axis=2), frames.boxes[i]) for i in range(0, len(frames.rows), 4))
    logits, hits = candidates(network, images)
    weights, shift = fit(logits, hits)
    mixing = weights[0] * np.eye(len(CLASSES))
    mixing[0] = weights
    motion = fit_motion(*(np.array(part) for part in zip(*paths(args.data, 'train', 'IR'), strict=True)),
                        MotionModel.least_speed)
    metadata = {'names': json.dumps(dict(enumerate(CLASSES))), 'task': 'detect', 'imgsz': str(INPUT), 'license': 'Apache-2.0',
                'steps': ' + '.join(str(state['step']) for state in states), 'motion': json.dumps(asdict(motion)),
                'description': 'Thermal drone detector, trained from the visible one; see the model card',
                'score_fusion': json.dumps(asdict(SCORE_FUSION))}
    write(Decoded(network, mixing, shift), args.out, metadata)
    low = Detector(args.out, DetectorSettings(score_threshold=SCORE_FUSION.floor, keep=('drone',), threads=1))
    results = detect_all(low, args.data, 'validation', kind='IR')
    # As a rig sees them. Each threshold is that of the best F1 at half of the false drones that are allowed: the clips are few.
    alone, in_time = (measure(results, low, temporal_fusion=fused) for fused in (False, True))
    metadata['score_threshold'] = str(choose_threshold(alone, 0.5 * FALSE))
    metadata['score_fusion'] = json.dumps(asdict(replace(SCORE_FUSION, threshold=choose_threshold(in_time, 0.5 * FALSE))))
    write(Decoded(network, mixing, shift), args.out, metadata)
    print(f'{args.out}: {len(hits)} boxes, {hits.sum()} drones, weights {np.round(weights, 3)}, shift {shift:.3f}, {motion}, '
          f'thresholds {metadata["score_threshold"]}, {metadata["score_fusion"]}')
    for name, one in (('alone', alone), ('in time', in_time)):
        for t in (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8):
            print(f'  {name} at {t}: F1 {one.f1(t):.3f}, recall {one.recall(t):.3f}, false {one.false_frames(t):.3f}')


if __name__ == '__main__':
    main()
