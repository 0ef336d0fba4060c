"""Where training starts: YOLOX-nano as trained on COCO (Megvii, Apache-2.0), or a detector of this project to be trained on."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import onnx
import torch
from network import Conv, Network
from onnx import numpy_helper
from torch import Tensor

AIRPLANE, BIRD, KITE = 4, 14, 33  # of COCO's 80 classes
FINE = ('lateral3', 'fine', 'down2')  # what this network has and YOLOX-nano has not
FOCUS = ((0, 0), (1, 0), (0, 1), (1, 1))  # row and column of the four pixels that YOLOX puts on top of one another


@torch.no_grad()
def start_from(network: Network, path: Path) -> None:
    """Take over all weights of an exported detector of ours or of an undecoded YOLOX-nano; ValueError for any other network.

    Of an exported detector the calibration is left behind. With YOLOX-nano a drone is at first what is half an airplane, a
    bird and a kite. What neither has (`FINE`) stays as it is.
    """
    graph = onnx.load(str(path)).graph
    stored = {one.name: torch.from_numpy(numpy_helper.to_array(one).copy()) for one in graph.initializer}
    theirs = [node.input[1:3] for node in graph.node if node.op_type == 'Conv' and 'preds' not in node.input[1]]
    by_name = {bias.removeprefix('network.').removesuffix('.bias'): (weight, bias) for weight, bias in theirs}
    own = 'stem' in by_name
    layers = {name: layer for name, layer in network.named_modules() if isinstance(layer, Conv)
              and (name in by_name or not name.startswith(FINE))}
    if own and by_name.keys() != layers.keys():
        other = ', '.join(sorted(by_name.keys() ^ layers.keys()))
        raise ValueError(f'{path} has other convolutions than this network: {other}')
    ours = list(layers.values()) if own else in_order(network, layers.values())
    theirs = [by_name[name] for name in layers] if own else theirs
    if len(theirs) != len(ours):
        raise ValueError(f'{path} has {len(theirs)} convolutions, expected the {len(ours)} of YOLOX-nano')
    for layer, (weight, bias) in zip(ours, theirs, strict=True):
        taken = first(stored[weight]) if layer is network.stem and not own else stored[weight]
        if taken.shape != layer.weight.shape:
            raise ValueError(f'{path}: {weight} is {tuple(taken.shape)}, expected {tuple(layer.weight.shape)}')
        layer.set(taken, stored[bias])
    if own:
        return
    for level, head in enumerate(network.heads):
        for layer, name in ((head.classes, 'cls'), (head.box, 'reg'), (head.object, 'obj')):
            weight, bias = (stored[f'head.{name}_preds.{level}.{kind}'] for kind in ('weight', 'bias'))
            layer.set(*((as_ours(weight), as_ours(bias)) if name == 'cls' else (weight, bias)))


@torch.no_grad()
def widen(small: Network, wide: Network, noise: float = 0.05) -> None:
    """Give a wider network what a trained one knows: each channel several times, which sum to what it was (Net2Net).

    It answers as the small one but for the noise (a share of each weight), which makes equal channels learn different things
    (Chen et al. 2016, arXiv:1511.05641).
    """
    theirs = (layer for layer in small.modules() if isinstance(layer, Conv))
    ours = (layer for layer in wide.modules() if isinstance(layer, Conv))
    for old, new in zip(theirs, ours, strict=True):
        if not old.gain.any():  # begins as nothing in both
            continue
        outputs, inputs = (new.weight.shape[k] // old.weight.shape[k] for k in (0, 1))
        weight = (old.weight * old.gain).repeat_interleave(outputs, 0).repeat_interleave(inputs, 1) / inputs
        new.set(weight * (1.0 + noise * torch.randn_like(weight)), old.bias.repeat_interleave(outputs))


def in_order(network: Network, layers: Iterable[Conv]) -> list[Conv]:
    """Some convolutions but the last ones in the order in which a image meets them."""
    met: list[Conv] = []
    hooks = [layer.register_forward_hook(lambda layer, *_: met.append(layer)) for layer in layers if not layer.last]
    network(torch.zeros(1, 3, 64, 64))
    for hook in hooks:
        hook.remove()
    return met


def first(weight: Tensor) -> Tensor:
    """YOLOX's first layer (n, 12, 3, 3) for BGR in 0-255 as one (n, 3, 6, 6) of stride 2 for RGB in 0-1."""
    wide = torch.zeros(len(weight), 3, 6, 6)
    for k, (row, column) in enumerate(FOCUS):
        wide[:, :, row::2, column::2] = weight[:, 3 * k:3 * k + 3]
    return wide.flip(1) * 255.0


def as_ours(rows: Tensor) -> Tensor:
    """Rows of COCO's classes as those of drone, bird, airplane, helicopter."""
    return torch.stack([rows[[AIRPLANE, BIRD, KITE]].mean(0), rows[BIRD], rows[AIRPLANE], rows[AIRPLANE]])
