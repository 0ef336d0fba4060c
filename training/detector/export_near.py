"""Export the network of the near pass, calibrated on places that it was not trained on.

`python export_near.py CHECKPOINT [CHECKPOINT ...] OUT.onnx --cache FOLDER --unseen LEFT_OUT [LEFT_OUT ...]`. Of several
checkpoints the mean of the weights is exported. The calibration is that of the checkpoints of `--unseen`, of the same recipe,
on the places that these left out: what a network knows of pictures that it was trained on says nothing about others.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from clips import CLASSES
from elsewhere import Elsewhere, look_at, together
from export import Decoded, fit, network_of, write
from near import INPUT
from places import SOURCES

from av_vision import Detector, DetectorSettings
from av_vision.score_fusion import logit

METADATA = {'names': json.dumps(dict(enumerate(CLASSES))), 'task': 'detect', 'imgsz': str(INPUT), 'license': 'Apache-2.0',
            'description': 'Near pass of the drone detector, trained from YOLOX-nano (Megvii, Apache-2.0)'}


def on_unseen(state: dict[str, Any], cache: Path, count: int) -> Elsewhere:
    """What a network scores, not calibrated, in pictures of the places that its training left out."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'near.onnx'
        write(Decoded(network_of([state])), path, METADATA)
        detector = Detector(path, DetectorSettings(score_threshold=0.01, keep=('drone',), threads=1))
        return together([look_at(detector, place, cache, count) for place in SOURCES if place.name in state['left_out']])


def trained_on(states: list[dict[str, Any]]) -> str:
    """The sets of pictures that any of some checkpoints was trained on, for the metadata."""
    return json.dumps([place.name for place in SOURCES if any(place.name not in state['left_out'] for state in states)])


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('checkpoints', type=Path, nargs='+', metavar='checkpoint')
    parser.add_argument('out', type=Path)
    parser.add_argument('--cache', type=Path, required=True)
    parser.add_argument('--unseen', type=Path, nargs='+', required=True, help='checkpoints of trainings that left places out')
    parser.add_argument('--count', type=int, default=400, help='pictures of each place')
    args = parser.parse_args()
    states, others = ([torch.load(path, map_location='cpu') for path in paths] for paths in (args.checkpoints, args.unseen))
    seen = together([on_unseen(state, args.cache, args.count) for state in others])
    gain, shift = fit(logit(seen.scores)[:, None], seen.hits)
    steps = ' + '.join(str(state['step']) for state in states)
    metadata = METADATA | {'steps': steps, 'places': trained_on(states)}
    write(Decoded(network_of(states), gain[0] * np.eye(len(CLASSES)), shift), args.out, metadata)
    print(f'{args.out}: steps {steps}, calibrated on {len(seen.hits)} boxes: gain {gain[0]:.3f}, shift {shift:.3f}')
    for threshold in (0.1, 0.2, 0.28, 0.4, 0.5, 0.6, 0.7):
        before = float(1.0 / (1.0 + np.exp(-(logit(threshold) - shift) / gain[0])))
        print(f'  at {threshold}: {seen.recall(before):.3f} found, '
              f'{seen.false_pictures(before):.3f} of the pictures with a false drone')


if __name__ == '__main__':
    main()
