"""Which cell answers for which object, and how wrong it is.

Task-aligned assignment (Feng et al. 2021, TOOD, eq. 1): the cells near an object's centre compete by score^a * IoU^b, the
best few answer for it, and the score they shall give is their rank scaled by the best IoU. Box loss: complete IoU
(Zheng et al. 2020, DIoU-loss). Class loss: binary cross-entropy against the soft scores.
"""

from __future__ import annotations

import torch
from network import to_boxes
from torch import Tensor
from torch.nn import functional

ALPHA, BETA, BEST = 0.5, 4.0, 9
REACH = 2.0  # in cells of the coarser of a cell and the object's quarter, how far from the centre a cell may answer


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
def assign(scores: Tensor, boxes: Tensor, truth: Tensor, corners: Tensor, strides: Tensor) -> tuple[Tensor, Tensor]:
    """For one picture: target scores (cells, classes) and for each cell the object it answers for, -1 for none.

    Scores (cells, classes) and boxes (cells, 4) are predictions, truth (k, 5) class, x1, y1, x2, y2.
    """
    target, owner = torch.zeros_like(scores), torch.full((len(scores),), -1, dtype=torch.long)
    if not len(truth):
        return target, owner
    label, real = truth[:, 0].long(), truth[:, 1:]
    centres = (corners + 0.5) * strides
    off = (centres[None] - 0.5 * (real[:, None, :2] + real[:, None, 2:])).abs().amax(-1)
    size = (real[:, 2:] - real[:, :2]).amax(-1, keepdim=True)
    allowed = off < torch.maximum(0.75 * strides[:, 0], torch.minimum(REACH * strides[:, 0], 0.5 * size))
    overlap = iou(boxes[None], real[:, None]) * allowed
    # Levels too fine for a large object see only a part of it, too coarse ones nothing of a small one.
    fit = (strides[:, 0] * 2.0 <= size) & (strides[:, 0] * 16.0 >= size) | (strides[:, 0] == 8) & (size < 32) \
        | (strides[:, 0] == 32) & (size > 256)
    metric = scores[:, label].T.pow(ALPHA) * overlap.pow(BETA) * fit + 1e-12 * (allowed & fit)
    best, place = metric.topk(BEST, dim=1)
    chosen = torch.zeros_like(metric).scatter_(1, place, (best > 0).float()) > 0
    contested = torch.where(chosen, overlap + 1e-6, torch.zeros_like(overlap))
    value, winner = contested.max(0)
    owner = torch.where(value > 0, winner, owner)
    mine = owner >= 0
    own_metric = metric[owner[mine], mine.nonzero()[:, 0]]
    top_metric = torch.zeros(len(truth)).scatter_reduce(0, owner[mine], own_metric, 'amax')
    top_overlap = torch.zeros(len(truth)).scatter_reduce(0, owner[mine], overlap[owner[mine], mine.nonzero()[:, 0]], 'amax')
    # Loose labels cap the IoU; the best cell shall still be sure of the class.
    wanted = own_metric / (top_metric[owner[mine]] + 1e-12) * (0.4 + 0.6 * top_overlap[owner[mine]])
    target[mine, label[owner[mine]]] = wanted
    return target, owner


def loss(logits: Tensor, raw: Tensor, truth: list[Tensor], corners: Tensor, strides: Tensor) -> tuple[Tensor, dict[str, float]]:
    """Total of a batch and its parts. Logits (n, cells, classes), raw (n, cells, 4), truth n times (k, 5)."""
    boxes = to_boxes(raw, corners, strides)
    scores = logits.detach().sigmoid()
    assigned = [assign(scores[i], boxes[i].detach(), truth[i], corners, strides) for i in range(len(truth))]
    target = torch.stack([scores_wanted for scores_wanted, _ in assigned])
    norm = target.sum().clamp(min=1.0)
    # Most cells are easy sky; those that answer for an object must tell its class from the others.
    answering = torch.stack([owner >= 0 for _, owner in assigned])[..., None]
    weight = torch.where(answering, 1.0, (scores - target).abs().clamp(min=0.02))
    entropy = functional.binary_cross_entropy_with_logits(logits, target, reduction='none')
    class_loss = (entropy * weight).sum() / norm
    predicted = torch.cat([boxes[i][owner >= 0] for i, (_, owner) in enumerate(assigned)])
    real = torch.cat([truth[i][owner[owner >= 0], 1:] for i, (_, owner) in enumerate(assigned)])
    weight = torch.cat([wanted[owner >= 0].sum(-1) for wanted, owner in assigned])
    box_loss = ((1.0 - complete_iou(predicted, real)) * weight).sum() / norm
    # The centre is the bearing: it is asked for beyond what the overlap asks.
    size = (real[:, 2:] - real[:, :2]).amax(-1, keepdim=True).clamp(min=8.0)
    off = (0.5 * (predicted[:, :2] + predicted[:, 2:] - real[:, :2] - real[:, 2:]) / size).abs().sum(-1)
    centre_loss = (off * weight).sum() / norm
    total = class_loss + 2.5 * box_loss + 1.0 * centre_loss
    return total, {'class': class_loss.item(), 'box': box_loss.item(), 'centre': centre_loss.item()}
