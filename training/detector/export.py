"""Export a checkpoint to ONNX in the layout of YOLOv8 (n, 4 + classes, cells), calibrated and with its metadata.

`python export.py CHECKPOINT [CHECKPOINT ...] OUT.onnx --cache FOLDER --data DRONE_DETECTION`. Of several checkpoints of one
run the mean of the weights is exported (Izmailov et al. 2018, arXiv:1803.05407): it is surer about places that no clip shows.

All that is fitted here comes from what a network was not trained on: the split `validation`, and the pictures of the places
that the checkpoints of `--unseen` (of the same recipe, each without a place) left out; what is known of a network on pictures
that it knows says nothing about others. Logistic regression (Platt 1999, with the other classes'
logits as further evidence against) is folded into the graph, so that a drone's score is the probability that it is one; the
threshold is the best for the clips as a rig sees them, in time (`av_vision.score_fusion`), and for rendered drones of all sizes
(of builds of their own), with few false drones on birds, airplanes and helicopters.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from album import cut
from clips import CLASSES, HEIGHT, Frames
from measure import FrameResult, Measurement, detect_all, match, measure
from network import STRIDES, Network, cells, to_boxes
from numpy.typing import NDArray
from painted import log_uniform
from pasting import paste
from places import SOURCES, pictures
from scipy.optimize import minimize
from sprites import build_bank
from torch import Tensor, nn

from av_vision import Detector, DetectorSettings
from av_vision.detections import suppress
from av_vision.score_fusion import ScoreFusionModel, logit
from av_vision.yolo.letterbox import fitting_size, letterbox, to_tensor

INPUT = 640  # pixels of the longer side
NEAR_INPUT = 192  # ... and what fills much of the image is seen as large as it was in training
LOWEST = 0.01
FALSE = 0.05  # share of images without a drone that may show one
# How the images of one thing belong together: their errors are the same (correlation 1), so that many images are no surer than
# their mean; of 0.5, 0.75 and 1 it makes the validation clips most likely (HISTORY.md). Beyond 2 s memory changes the
# likelihood by less than 1 %; the shorter it is, the sooner a mind is changed.
SCORE_FUSION = ScoreFusionModel(prior=-0.77, correlation=1.0, memory_s=3.0, floor=0.02, threshold=0.4)


class Decoded(nn.Module):
    """The network with its answers as boxes in pixels and probabilities, (n, 4 + classes, cells)."""

    def __init__(self, network: Network, mixing: NDArray | None = None, shift: float = 0.0) -> None:
        """`mixing` (classes, classes) takes logits to calibrated ones, `shift` is added to them."""
        super().__init__()
        self.network = network
        self.register_buffer('mixing', torch.eye(len(CLASSES)) if mixing is None else torch.tensor(mixing).float())
        self.shift = shift

    def forward(self, x: Tensor) -> Tensor:
        """Images (n, 3, h, w) RGB in 0-1."""
        logits, raw = self.network.answers(x)
        corners, strides = [], []
        for stride in STRIDES:
            rows, columns = x.shape[2] // stride, x.shape[3] // stride
            y = torch.arange(rows)[:, None].expand(rows, columns).reshape(-1)
            x_cell = torch.arange(columns)[None].expand(rows, columns).reshape(-1)
            corners.append(torch.stack([x_cell, y]).float())
            strides.append(torch.full_like(corners[-1][:1], stride))
        corner, step = torch.cat(corners, 1), torch.cat(strides, 1)
        boxes = torch.cat([raw[:, :2] + corner, torch.exp(raw[:, 2:].clamp(max=6.0))], 1) * step
        return torch.cat([boxes, torch.sigmoid(self.mixing @ logits + self.shift)], 1)


def mean_of(weights: list[dict[str, Tensor]]) -> dict[str, Tensor]:
    """Tensor by tensor."""
    return {name: torch.stack([each[name] for each in weights]).mean(0) for name in weights[0]}


def write(model: Decoded, path: Path, metadata: dict[str, str]) -> None:
    """Write the ONNX file with dynamic batch and size."""
    axes = {'images': {0: 'batch', 2: 'height', 3: 'width'}, 'output': {0: 'batch', 2: 'cells'}}
    torch.onnx.export(model.eval(), torch.rand(1, 3, 512, 640), str(path), dynamo=False, opset_version=17,
                      input_names=['images'], output_names=['output'], dynamic_axes=axes)
    graph = onnx.load(str(path))
    onnx.helper.set_model_props(graph, metadata)
    onnx.save(graph, str(path))


def fit(logits: NDArray, hits: NDArray, counts: NDArray | float = 1.0) -> tuple[NDArray, float]:
    """Weights (k,) and shift that make sigmoid(logits (n, k) @ weights + shift) the probability of being a hit.

    The first logit speaks for a drone, the others never do.

    Parameters:
        logits (n, k): of candidates.
        hits (n,): which of them are drones.
        counts (n,): what each candidate counts.
    """
    def unlikelihood(x: NDArray) -> float:
        z = logits @ x[:-1] + x[-1]
        return float(np.sum(counts * (np.logaddexp(0.0, z) - hits * z))) + 0.1 * float(x[:-1] @ x[:-1])

    bounds = [(0.01, None)] + [(None, 0.0)] * (logits.shape[1] - 1) + [(None, None)]
    found = minimize(unlikelihood, np.r_[1.0, np.zeros(logits.shape[1])], bounds=bounds, method='L-BFGS-B').x
    return found[:-1], float(found[-1])


@torch.no_grad()
def candidates(network: Network, images: Iterable[tuple[NDArray, NDArray]]) -> tuple[NDArray, NDArray]:
    """Of images and their boxes (k, 5): logits (n, classes) of what might be drones, and whether it is (IoU at least 0.3)."""
    found, hits = [np.empty((0, len(CLASSES)), np.float32)], [np.empty(0, bool)]
    for image, truth in images:
        fitted, scale = letterbox(image, *fitting_size(*image.shape[:2], INPUT))
        logits, raw = network(torch.from_numpy(to_tensor(fitted, True, np.float32)))
        some = torch.sigmoid(logits[0, :, 0]) > LOWEST
        corners, strides = cells(*fitted.shape[:2])
        logits, boxes = logits[0, some].numpy(), to_boxes(raw[0], corners, strides)[some].numpy()
        kept = suppress(boxes, logits[:, 0] + 10.0)
        found.append(logits[kept])
        hits.append(match(boxes[kept], scale * truth[truth[:, 0] == 0, 1:])[0] >= 0.3)
    return np.concatenate(found), np.concatenate(hits)


def network_of(states: list[dict[str, Any]]) -> Network:
    """The network of the mean of some checkpoints' weights."""
    network = Network(times=states[0].get('wide', 1))
    network.load_state_dict(mean_of([state['average'] for state in states]))
    return network.eval()


def unseen(state: dict[str, Any], cache: Path, count: int = 400) -> Iterator[tuple[NDArray, NDArray]]:
    """Some pictures of each place that a checkpoint's training left out, with their boxes."""
    for place in SOURCES:
        if place.name in state.get('left_out', ()):
            there = list(pictures(place, cache))
            for i in np.random.default_rng(0).permutation(len(there))[:count]:
                yield there[i].load()


def rendered(detector: Detector, frames: Frames, sprites: list[NDArray], count: int = 500) -> list[FrameResult]:
    """Results of single images with drones of 12 to 300 pixels pasted over frames, for the clips show none that is near."""
    rng, results = np.random.default_rng(0), []
    while len(results) < count:
        i = int(rng.integers(len(frames)))
        crop = np.ascontiguousarray(frames.image(i)[:, :HEIGHT])
        there = cut(frames.boxes[i], HEIGHT, HEIGHT)
        truth = paste(rng, crop, there, sprites, log_uniform(rng, 12.0, 300.0), 1.0, np.zeros(3), 0)
        if len(truth) > len(there):
            seen = detector.candidates(crop, detector.threshold)
            results.append(FrameResult(f'rendered {len(results)}', 0.0, seen, truth, truth))
    return results


def choose_threshold(result: Measurement, most: float = FALSE) -> float:
    """That of the best F1 on images of drones, of those at which a share of fewer than `most` of the other images show one."""
    allowed = [t for t in np.arange(0.1, 0.96, 0.01) if result.false_frames(t) < most]
    return round(float(max(allowed, key=result.f1, default=0.95)), 2)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('checkpoints', type=Path, nargs='+', metavar='checkpoint')
    parser.add_argument('out', type=Path)
    parser.add_argument('--cache', type=Path, required=True)
    parser.add_argument('--data', type=Path, required=True)
    parser.add_argument('--unseen', type=Path, nargs='*', default=[], help='checkpoints of trainings that left places out')
    args = parser.parse_args()
    states = [torch.load(checkpoint, map_location='cpu') for checkpoint in args.checkpoints]
    steps = ' + '.join(f'{count} x {step}' for step, count in Counter(state['step'] for state in states).items())
    network = network_of(states)
    frames = Frames(args.cache, 'validation')
    names = json.dumps(dict(enumerate(CLASSES)))
    known = candidates(network, ((frames.image(i), frames.boxes[i]) for i in range(len(frames))))
    others = [torch.load(checkpoint, map_location='cpu') for checkpoint in args.unseen] or states[-1:]
    parts = [known, *(candidates(network_of([state]), unseen(state, args.cache)) for state in others)]
    print('calibrated on', ', '.join(f'{len(hits)} boxes, {np.sum(hits)} drones' for _, hits in parts), flush=True)
    weights, shift = fit(*(np.concatenate(each) for each in zip(*parts, strict=True)))
    mixing = weights[0] * np.eye(len(CLASSES))
    mixing[0] = weights
    metadata = {'names': names, 'task': 'detect', 'imgsz': str(INPUT), 'near_imgsz': str(NEAR_INPUT),
                'license': 'Apache-2.0', 'steps': steps,
                'description': 'Drone detector, trained from YOLOX-nano (Megvii, Apache-2.0); see the model card'}
    low = DetectorSettings(score_threshold=LOWEST, keep=('drone',))
    write(Decoded(network, mixing, shift), args.out, metadata)
    # What the other classes take away in suppression changes the odds a little: once more, for all alike.
    first = Detector(args.out, low)
    alone = measure(detect_all(first, args.data, 'validation'), first, temporal_fusion=False)
    gain, more = fit(logit(alone.scores)[:, None], alone.hits)
    mixing, shift = gain[0] * mixing, gain[0] * shift + more
    metadata['score_fusion'] = json.dumps(asdict(SCORE_FUSION))
    write(Decoded(network, mixing, shift), args.out, metadata)
    final = Detector(args.out, replace(low, score_threshold=SCORE_FUSION.floor))  # as on a rig
    results = detect_all(final, args.data, 'validation')
    results += rendered(final, frames, build_bank(args.cache, 'validation')['drone'])
    result = measure(results, final)
    metadata['score_threshold'] = str(choose_threshold(result))
    write(Decoded(network, mixing, shift), args.out, metadata)
    print(f'{args.out}: {args.out.stat().st_size / 1e6:.1f} MB, steps {steps}, weights {np.round(mixing[0], 3)}, '
          f'shift {shift:.3f}, score fusion {metadata["score_fusion"]}, threshold {metadata["score_threshold"]}')
    for t in (float(metadata['score_threshold']), 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9):
        print(f'  at {t}: F1 {result.f1(t):.3f}, with false frames {result.f1(t, everywhere=True):.3f}, '
              f'recall {result.recall(t):.3f}, false frames {result.false_frames(t):.3f}')


if __name__ == '__main__':
    main()
