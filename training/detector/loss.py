"""Which cell answers for which object, and how wrong it is.

The size of an object decides its level, its centre the cells: those within 0.75 cells of it shall say its class, up to four.
Nothing has to be negotiated between cells that look alike, which makes learning fast. Cells a little further off, and the
same place on a neighbouring level when the size is near the border between two, are not blamed for either answer about the
object's own class (in the spirit of CenterNet, Zhou et al. 2019, arXiv:1904.07850); that a bird is no drone they have to know.
Box loss: complete IoU (Zheng et al. 2020, DIoU-loss). Class loss: binary cross-entropy, on the many empty cells weighted by
the score (focal).
"""

from __future__ import annotations

import torch
from network import to_boxes
from torch import Tensor
from torch.nn import functional

ANSWERS, LENIENT = 0.75, 1.75  # distances from the centre in cells
SIZE_IN_CELLS = 4.5            # of an object in the middle of its level's range
CONFUSED, EMPTY = 2.0, 2.5     # weights of a wrong class for an object, and of an object where there is none
BORDER = 0.35                  # of an octave to both sides of the border between two levels


def iou(a: Tensor, b: Tensor) -> Tensor:
    """Intersection over union of boxes (..., 4), broadcast."""
    shared = (torch.minimum(a[..., 2:], b[..., 2:]) - torch.maximum(a[..., :2], b[..., :2])).clamp(min=0).prod(-1)
    areas = (a[..., 2:] - a[..., :2]).prod(-1) + (b[..., 2:] - b[..., :2]).prod(-1)
    return shared / (areas - shared + 1e-7)


def complete_iou(a: Tensor, b: Tensor) -> Tensor:
    """IoU less the distance of centres and the difference in aspect."""
    overlap = iou(a, b)
    hull = torch.maximum(a[..., 2:], b[..., 2:]) - torch.minimum(a[..., :2], b[..., :2])
    apart = 0.25 * (a[..., :2] + a[..., 2:] - b[..., :2] - b[..., 2:]).pow(2).sum(-1) / (hull.pow(2).sum(-1) + 1e-7)
    size_a, size_b = a[..., 2:] - a[..., :2], b[..., 2:] - b[..., :2]
    turn = torch.atan(size_b[..., 0] / (size_b[..., 1] + 1e-7)) - torch.atan(size_a[..., 0] / (size_a[..., 1] + 1e-7))
    aspect = 0.4052847 * turn.pow(2)  # 4 / pi^2
    with torch.no_grad():
        weight = aspect / (1.0 - overlap + aspect + 1e-7)
    return overlap - apart - weight * aspect


@torch.no_grad()
def assign(truth: Tensor, corners: Tensor, strides: Tensor) -> tuple[Tensor, Tensor]:
    """For each cell the object (k, 5: class, x1, y1, x2, y2) it answers for, -1 for none, and that it is let off for, too."""
    owner = torch.full((len(corners),), -1, dtype=torch.long, device=corners.device)
    lenient = owner.clone()
    if not len(truth):
        return owner, lenient
    centre = 0.5 * (truth[:, None, 1:3] + truth[:, None, 3:5])
    off = ((corners + 0.5) - centre / strides).abs().amax(-1)
    size = (truth[:, 3:] - truth[:, 1:3]).amax(-1, keepdim=True).clamp(min=4.0)
    octave = torch.log2(size / SIZE_IN_CELLS / strides[:, 0])
    lowest, highest = strides[:, 0] == strides.min(), strides[:, 0] == strides.max()
    octave = torch.where(lowest & (octave < 0) | highest & (octave > 0), torch.zeros_like(octave), octave)
    mine = (octave.abs() <= 0.5) & (off < ANSWERS)
    near = torch.where((octave.abs() <= 0.5 + BORDER) & (off < LENIENT), off, torch.full_like(off, torch.inf)).min(0)
    lenient = torch.where(near.values.isfinite(), near.indices, lenient)
    distance, nearest = torch.where(mine, off, torch.full_like(off, torch.inf)).min(0)
    owner = torch.where(distance.isfinite(), nearest, owner)
    return owner, lenient


def loss(logits: Tensor, raw: Tensor, truth: list[Tensor], corners: Tensor, strides: Tensor) -> tuple[Tensor, dict[str, float]]:
    """Total of a batch and its parts. Logits (n, cells, classes), raw (n, cells, 4), truth n times (k, 5)."""
    assigned = [assign(one, corners, strides) for one in truth]
    owner, lenient = torch.stack([one for one, _ in assigned]), torch.stack([one for _, one in assigned])
    answering = owner >= 0
    norm = answering.sum().clamp(min=1)
    real = torch.cat([one[mine[mine >= 0]] for one, mine in zip(truth, owner, strict=True)])
    target = torch.zeros_like(logits)
    target[answering] = functional.one_hot(real[:, 0].long(), logits.shape[-1]).float()
    scores = logits.detach().sigmoid()
    let_off = torch.zeros_like(logits, dtype=torch.bool)
    for one, near, row in zip(truth, lenient, let_off, strict=True):
        some = torch.nonzero(near >= 0)[:, 0]
        row[some, one[near[some], 0].long()] = True
    named = torch.where(target > 0, 1.0, CONFUSED)
    weight = torch.where(answering[..., None], named, torch.where(let_off, 0.0, EMPTY * scores))
    class_loss = (functional.binary_cross_entropy_with_logits(logits, target, reduction='none') * weight).sum() / norm
    predicted, real = to_boxes(raw, corners, strides)[answering], real[:, 1:]
    box_loss = (1.0 - complete_iou(predicted, real)).sum() / norm
    # The centre is the bearing: it is asked for beyond what the overlap asks.
    size = (real[:, 2:] - real[:, :2]).amax(-1, keepdim=True).clamp(min=8.0)
    off = (0.5 * (predicted[:, :2] + predicted[:, 2:] - real[:, :2] - real[:, 2:]) / size).abs().sum(-1)
    centre_loss = off.sum() / norm
    total = class_loss + 2.0 * box_loss + centre_loss
    return total, {'class': class_loss.item(), 'box': box_loss.item(), 'centre': centre_loss.item()}
