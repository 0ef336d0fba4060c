"""The detector's network: that of YOLOX-nano (Ge et al. 2021, arXiv:2107.08430), its pyramid one level finer.

A CSP-Darknet of depthwise convolutions, a path-aggregating pyramid and decoupled heads with one class answer a cell. What is
seen at stride 4 is added to level 8 (as bottom-up paths do, Liu et al. 2018, arXiv:1803.01534) for the sake of small drones; it
has no head of its own. Training starts from trained weights (`start.py`), whose batch normalisation is folded away; instead
each channel has a gain of its own and weights of length one (Salimans and Kingma 2016, arXiv:1602.07868), so that one learning
rate fits all.
Input (n, 3, h, w) RGB in 0-1. One prediction a cell of strides 8, 16, 32 (order of `av_vision.yolo.layout.grid`).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

STRIDES = (8, 16, 32)


class Conv(nn.Module):
    """Convolution and, unless it is a last layer, SiLU; random at first."""

    def __init__(self, inputs: int, outputs: int, size: int = 1, stride: int = 1, groups: int = 1, last: bool = False) -> None:
        super().__init__()
        self.stride, self.groups, self.last = stride, groups, last
        self.padding = (size - 1) // 2
        self.weight = nn.Parameter(functional.normalize(torch.randn(outputs, inputs // groups, size, size), dim=(1, 2, 3)))
        self.gain = nn.Parameter(torch.full((outputs, 1, 1, 1), 1.5))  # about what SiLU takes away
        self.bias = nn.Parameter(torch.zeros(outputs))

    @torch.no_grad()
    def set(self, weight: Tensor, bias: Tensor) -> None:
        """Take over plain weights (outputs, inputs / groups, size, size) and bias (outputs,)."""
        size = weight.flatten(1).norm(dim=1).clamp(min=1e-6)[:, None, None, None]
        self.weight.copy_(weight / size)
        self.gain.copy_(size)
        self.bias.copy_(bias)

    def forward(self, x: Tensor) -> Tensor:
        """(n, inputs, h, w) to (n, outputs, h / stride, w / stride)."""
        y = functional.conv2d(x, self.weight * self.gain, self.bias, self.stride, self.padding, 1, self.groups)
        return y if self.last else functional.silu(y)


def separable(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """3 x 3 a channel, then 1 x 1."""
    return nn.Sequential(Conv(inputs, inputs, 3, stride, inputs), Conv(inputs, outputs))


class Stage(nn.Module):
    """Half of the channels go through bottlenecks, half past them (CSPNet, Wang et al. 2019)."""

    def __init__(self, inputs: int, outputs: int, count: int, residual: bool) -> None:
        super().__init__()
        half = outputs // 2
        self.through, self.past, self.join = Conv(inputs, half), Conv(inputs, half), Conv(2 * half, outputs)
        self.body = nn.ModuleList(nn.Sequential(Conv(half, half), separable(half, half)) for _ in range(count))
        self.residual = residual

    def forward(self, x: Tensor) -> Tensor:
        """(n, inputs, h, w) to (n, outputs, h, w)."""
        y = self.through(x)
        past = self.past(x)
        for block in self.body:
            y = block(y) + y if self.residual else block(y)
        return self.join(torch.cat([y, past], 1))


class Pool(nn.Module):
    """Spatial pyramid pooling: what is in the neighbourhood, near and far (He et al. 2015)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.narrow, self.join = Conv(width, width // 2), Conv(2 * width, width)

    def forward(self, x: Tensor) -> Tensor:
        """(n, width, h, w) to the same."""
        x = self.narrow(x)
        return self.join(torch.cat([x] + [functional.max_pool2d(x, size, 1, size // 2) for size in (5, 9, 13)], 1))


class Head(nn.Module):
    """Class and box of every cell of a level: what it is and that it is anything at all are added up as log-odds."""

    def __init__(self, inputs: int, classes: int, width: int) -> None:
        super().__init__()
        self.stem = Conv(inputs, width)
        self.what = nn.Sequential(separable(width, width), separable(width, width))
        self.where = nn.Sequential(separable(width, width), separable(width, width))
        self.classes, self.box, self.object = (Conv(width, count, last=True) for count in (classes, 4, 1))

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """(n, inputs, h, w) to class logits (n, classes, h w) and raw boxes (n, 4, h w)."""
        x = self.stem(x)
        what, where = self.what(x), self.where(x)
        return (self.classes(what) + self.object(where)).flatten(2), self.box(where).flatten(2)


class Network(nn.Module):
    """Backbone, feature pyramid (top-down and bottom-up), heads for class and box; `times` as wide as YOLOX-nano."""

    def __init__(self, classes: int = 4, times: int = 1) -> None:
        super().__init__()
        c16, c32, c64, c128, c256 = (times * width for width in (16, 32, 64, 128, 256))
        self.stem = Conv(3, c16, 6, 2)
        self.dark2 = nn.Sequential(separable(c16, c32, 2), Stage(c32, c32, 1, True))
        self.dark3 = nn.Sequential(separable(c32, c64, 2), Stage(c64, c64, 3, True))
        self.dark4 = nn.Sequential(separable(c64, c128, 2), Stage(c128, c128, 3, True))
        self.dark5 = nn.Sequential(separable(c128, c256, 2), Pool(c256), Stage(c256, c256, 1, False))
        self.lateral5, self.join4 = Conv(c256, c128), Stage(c256, c128, 1, False)
        self.lateral4, self.join3 = Conv(c128, c64), Stage(c128, c64, 1, False)
        self.lateral3, self.fine, self.down2 = Conv(c64, c32), separable(c32, c32), separable(c32, c64, 2)
        nn.init.zeros_(self.down2[1].gain)  # begins as nothing, so that trained weights mean what they meant
        self.down3, self.up4 = separable(c64, c64, 2), Stage(c128, c128, 1, False)
        self.down4, self.up5 = separable(c128, c128, 2), Stage(c256, c256, 1, False)
        self.heads = nn.ModuleList(Head(width, classes, c64) for width in (c64, c128, c256))

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Class logits (n, cells, classes) and raw boxes (n, cells, 4): offset from the cell in cells, log size in cells."""
        logits, boxes = self.answers(x)
        return logits.transpose(1, 2), boxes.transpose(1, 2)

    def answers(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """The same with the cells last: (n, classes, cells) and (n, 4, cells)."""
        c2 = self.dark2(self.stem(x))
        c3 = self.dark3(c2)
        c4 = self.dark4(c3)
        c5 = self.dark5(c4)
        l5 = self.lateral5(c5)
        p4 = self.join4(torch.cat([functional.interpolate(l5, scale_factor=2.0), c4], 1))
        l4 = self.lateral4(p4)
        p3 = self.join3(torch.cat([functional.interpolate(l4, scale_factor=2.0), c3], 1))
        p2 = functional.interpolate(self.lateral3(p3), scale_factor=2.0) + c2
        p3 = p3 + self.down2(p2 + self.fine(p2))
        p4 = self.up4(torch.cat([self.down3(p3), l4], 1))
        p5 = self.up5(torch.cat([self.down4(p4), l5], 1))
        answers = [head(level) for head, level in zip(self.heads, (p3, p4, p5), strict=True)]
        logits, boxes = zip(*answers, strict=True)
        return torch.cat(logits, 2), torch.cat(boxes, 2)


def cells(height: int, width: int) -> tuple[Tensor, Tensor]:
    """Corners (cells, 2) in cells and strides (cells, 1), fine to coarse, row by row."""
    corners, strides = [], []
    for stride in STRIDES:
        y, x = torch.meshgrid(torch.arange(height // stride), torch.arange(width // stride), indexing='ij')
        corners.append(torch.stack([x, y], -1).reshape(-1, 2).float())
        strides.append(torch.full((x.numel(), 1), float(stride)))
    return torch.cat(corners), torch.cat(strides)


def to_boxes(raw: Tensor, corners: Tensor, strides: Tensor) -> Tensor:
    """Boxes (..., 4) x1, y1, x2, y2 in pixels from raw predictions."""
    centre = (raw[..., :2] + corners) * strides
    half = 0.5 * torch.exp(raw[..., 2:].clamp(max=6.0)) * strides
    return torch.cat([centre - half, centre + half], -1)
