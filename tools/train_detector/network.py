"""The detector's network: a small convolutional pyramid with one anchor-free head, in plain convolutions and ReLU.

Plain 3 x 3 convolutions are what CPUs run and train fastest for the same arithmetic; depthwise ones wait for memory.
Input (n, 3, h, w) RGB in 0-1. One prediction a cell of strides 8, 16, 32 (order of `av_vision.yolo.layout.grid`).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

STRIDES = (8, 16, 32)


def conv(inputs: int, outputs: int, size: int = 3, stride: int = 1) -> nn.Sequential:
    """Convolution, batch normalisation, ReLU."""
    return nn.Sequential(nn.Conv2d(inputs, outputs, size, stride, size // 2, bias=False),
                         nn.BatchNorm2d(outputs, eps=1e-3, momentum=0.03), nn.ReLU(inplace=True))


class Residual(nn.Module):
    """Two convolutions past which the input is passed on; the inner one is narrower."""

    def __init__(self, width: int, inner: int) -> None:
        super().__init__()
        self.body = nn.Sequential(conv(width, inner, 1), conv(inner, width, 3))

    def forward(self, x: Tensor) -> Tensor:
        """(n, width, h, w) to the same."""
        return x + self.body(x)


class Pool(nn.Module):
    """Spatial pyramid pooling: what is in the neighbourhood, near and far (He et al. 2015; the fast form of YOLOv5)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.narrow, self.join = conv(width, width // 2, 1), conv(2 * width, width, 1)
        self.pool = nn.MaxPool2d(5, 1, 2)

    def forward(self, x: Tensor) -> Tensor:
        """(n, width, h, w) to the same."""
        steps = [self.narrow(x)]
        for _ in range(3):
            steps.append(self.pool(steps[-1]))
        return self.join(torch.cat(steps, 1))


class Network(nn.Module):
    """Backbone, feature pyramid (top-down and bottom-up), shared-width heads for class and box."""

    def __init__(self, classes: int = 4, widths: tuple[int, ...] = (16, 24, 48, 96, 128), neck: int = 48) -> None:
        super().__init__()
        a, b, c, d, e = widths
        self.stem = nn.Sequential(conv(3, a, 3, 2), conv(a, b, 3, 2), Residual(b, b // 2))
        self.fine = nn.Sequential(conv(b, c, 3, 2), Residual(c, c // 2), Residual(c, c // 2))
        self.middle = nn.Sequential(conv(c, d, 3, 2), Residual(d, d // 2), Residual(d, d // 2))
        self.coarse = nn.Sequential(conv(d, e, 3, 2), Residual(e, e // 2), Pool(e))
        self.lateral = nn.ModuleList(conv(width, neck, 1) for width in (c, d, e))
        self.down = nn.ModuleList(conv(neck, neck) for _ in range(2))
        self.up = nn.ModuleList(conv(neck, neck, 3, 2) for _ in range(2))
        self.head = nn.ModuleList(nn.Sequential(conv(neck, neck), conv(neck, neck)) for _ in STRIDES)
        self.classes = nn.ModuleList(nn.Conv2d(neck, classes, 1) for _ in STRIDES)
        self.box = nn.ModuleList(nn.Conv2d(neck, 4, 1) for _ in STRIDES)
        for layer in self.classes:
            nn.init.constant_(layer.bias, -5.0)  # at the start nothing is seen anywhere
        for layer in self.box:
            nn.init.zeros_(layer.weight)
            layer.bias.data = torch.tensor([0.5, 0.5, 1.0, 1.0])

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Class logits (n, cells, classes) and raw boxes (n, cells, 4): offset from the cell in cells, log size in cells."""
        fine = self.fine(self.stem(x))
        middle = self.middle(fine)
        coarse = self.coarse(middle)
        p3, p4, p5 = (layer(level) for layer, level in zip(self.lateral, (fine, middle, coarse), strict=True))
        p4 = self.down[1](p4 + nn.functional.interpolate(p5, scale_factor=2.0))
        p3 = self.down[0](p3 + nn.functional.interpolate(p4, scale_factor=2.0))
        p4 = p4 + self.up[0](p3)
        p5 = p5 + self.up[1](p4)
        features = [head(level) for head, level in zip(self.head, (p3, p4, p5), strict=True)]
        logits = torch.cat([layer(f).flatten(2) for layer, f in zip(self.classes, features, strict=True)], 2)
        boxes = torch.cat([layer(f).flatten(2) for layer, f in zip(self.box, features, strict=True)], 2)
        return logits.transpose(1, 2), boxes.transpose(1, 2)


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
