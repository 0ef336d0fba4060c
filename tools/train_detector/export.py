"""Export a checkpoint to ONNX in the layout of YOLOv8 (n, 4 + classes, cells), calibrated and with its metadata.

`python export.py CHECKPOINT OUT.onnx --cache FOLDER`. Calibration and threshold come from the split `choose` alone:
Platt scaling (Platt 1999) fitted to the drones is folded into the graph, the same for all classes so that their order stays:
a drone's score is the probability that it is one.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
import onnx
import torch
from clips import CLASSES, Frames
from measure import Measurement, measure
from network import STRIDES, Network
from numpy.typing import NDArray
from scipy.optimize import minimize
from torch import Tensor, nn

from av_vision.yolo import Detector, DetectorSettings

LOWEST = 0.01


class Decoded(nn.Module):
    """The network with its answers as boxes in pixels and probabilities, (n, 4 + classes, cells)."""

    def __init__(self, network: Network, scale: float = 1.0, shift: float = 0.0) -> None:
        super().__init__()
        self.network = network
        self.scale, self.shift = scale, shift

    def forward(self, x: Tensor) -> Tensor:
        """Pictures (n, 3, h, w) RGB in 0-1."""
        logits, raw = self.network(x)
        corners, strides = [], []
        for stride in STRIDES:
            rows, columns = x.shape[2] // stride, x.shape[3] // stride
            y = torch.arange(rows)[:, None].expand(rows, columns).reshape(-1)
            x_cell = torch.arange(columns)[None].expand(rows, columns).reshape(-1)
            corners.append(torch.stack([x_cell, y], 1).float())
            strides.append(torch.full_like(corners[-1][:, :1], stride))
        corner, step = torch.cat(corners), torch.cat(strides)
        centre = (raw[..., :2] + corner) * step
        size = torch.exp(raw[..., 2:].clamp(max=6.0)) * step
        return torch.cat([centre, size, torch.sigmoid(self.scale * logits + self.shift)], -1).transpose(1, 2)


def write(model: Decoded, path: Path, metadata: dict[str, str]) -> None:
    """Write the ONNX file with dynamic batch and size."""
    axes = {'images': {0: 'batch', 2: 'height', 3: 'width'}, 'output': {0: 'batch', 2: 'cells'}}
    torch.onnx.export(model.eval(), torch.rand(1, 3, 512, 640), str(path), dynamo=False, opset_version=17,
                      input_names=['images'], output_names=['output'], dynamic_axes=axes)
    graph = onnx.load(str(path))
    onnx.helper.set_model_props(graph, metadata)
    onnx.save(graph, str(path))


def fit_platt(scores: NDArray, hits: NDArray) -> tuple[float, float]:
    """Gain and shift of the logit that make scores (n,) the probability of being a hit."""
    logits = np.log(scores / (1.0 - scores))

    def unlikelihood(x: NDArray) -> float:
        z = x[0] * logits + x[1]
        return float(np.sum(np.logaddexp(0.0, z) - hits * z)) + 1e-3 * float(x @ x)

    return tuple(minimize(unlikelihood, np.array([1.0, 0.0]), method='Nelder-Mead').x)


def choose_threshold(result: Measurement) -> float:
    """The threshold of the best F1, false drones on pictures of birds, airplanes and helicopters counted."""
    return round(float(max(np.arange(0.2, 0.96, 0.01), key=lambda t: result.f1(t, everywhere=True))), 2)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('checkpoint', type=Path)
    parser.add_argument('out', type=Path)
    parser.add_argument('--cache', type=Path, required=True)
    args = parser.parse_args()
    state = torch.load(args.checkpoint)
    network = Network()
    network.load_state_dict(state['average'])
    network.eval()
    frames = Frames(args.cache, 'choose')
    names = json.dumps(dict(enumerate(CLASSES)))
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder, 'plain.onnx')
        write(Decoded(network), plain, {'names': names})
        result = measure(Detector(plain, DetectorSettings(score_threshold=LOWEST, keep=('drone',))), frames)
    gain, shift = fit_platt(result.scores, result.hits)
    result.scores = 1.0 / (1.0 + np.exp(-gain * np.log(result.scores / (1 - result.scores)) - shift))
    threshold = choose_threshold(result)
    metadata = {'names': names, 'task': 'detect', 'imgsz': '640', 'score_threshold': str(threshold), 'license': 'Apache-2.0',
                'description': 'Drone detector trained from scratch; see the model card', 'steps': str(state['step'])}
    write(Decoded(network, gain, shift), args.out, metadata)
    print(f'{args.out}: {args.out.stat().st_size / 1e6:.1f} MB, step {state["step"]}, gain {gain:.3f}, shift {shift:.3f}, '
          f'threshold {threshold}; choose: F1 {result.f1(threshold):.3f}, false frames {result.false_frames(threshold):.3f}')


if __name__ == '__main__':
    main()
