"""Pasting renders and cut-out objects into images."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from painted import Rng

PLACES = 4  # candidates, of which the most crowded one is taken


def paste(rng: Rng, image: NDArray, boxes: NDArray, sprites: list[NDArray], size: float, transmission: float, veil: NDArray,
          label: int | None, crowded: bool = False) -> NDArray[np.float32]:
    """Blend a sprite of `size` pixels into the image in place; returns the boxes with its own, without those it hides.

    Anywhere, or where it is `crowded`: of a few places the one with the most behind the sprite.
    A drone too faint for anybody to see is left out: it is neither there nor not there.
    """
    side = image.shape[0]
    sprite = sprites[rng.integers(len(sprites))]
    scale = min(size / max(sprite.shape[:2]), 3.0)
    small = cv2.resize(sprite, (max(round(sprite.shape[1] * scale), 2), max(round(sprite.shape[0] * scale), 2)),
                       interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    small = small[:, ::-1] if rng.random() < 0.5 else small
    if rng.random() < 0.4:
        small = tilt(small, rng.uniform(-35, 35))
    h, w = small.shape[:2]
    if h >= side or w >= side:
        return boxes
    x, y = int(rng.integers(0, side - w)), int(rng.integers(0, side - h))
    if crowded:
        places = [[x, y], *rng.integers(0, [side - w, side - h], (PLACES, 2)).tolist()]
        free = [not shared_with(boxes, *place, w, h).any() for place in places]
        x, y = max(zip(free, places, strict=True), key=lambda one: one[0] * crowd(image, *one[1], w, h))[1]
    alpha = small[..., 3:].astype(np.float32) / 255.0
    if size > 12 and rng.random() < 0.5:
        alpha = cv2.GaussianBlur(alpha, (0, 0), 0.6)[..., None]
    light = rng.uniform(0.5, 1.6)
    shade = fog(np.clip(small[..., :3] * light, 0, 255), transmission, veil).astype(np.float32)
    under = image[y:y + h, x:x + w].astype(np.float32)
    blended = alpha * shade + (1 - alpha) * under
    change = np.abs(blended - under).mean(axis=2)
    if label is not None and np.percentile(change, 90) < 7.0:
        return boxes
    image[y:y + h, x:x + w] = blended.astype(np.uint8)
    box = np.array([x, y, x + w, y + h], np.float32)
    boxes = boxes[shared_with(boxes, x, y, w, h) < 0.4]
    if label is None:
        return boxes
    return np.concatenate([boxes, np.array([[label, *box]])]).astype(np.float32)


def crowd(image: NDArray[np.uint8], x: int, y: int, w: int, h: int) -> float:
    """How much there is to see in a part of a image: spread of its green, of which every second row and column are read."""
    return float(image[y:y + h:2, x:x + w:2, 1].std())


def shared_with(boxes: NDArray, x: int, y: int, w: int, h: int) -> NDArray[np.float32]:
    """Share (k,) of each box (k, 5) that a part of the image hides."""
    sides = np.minimum(boxes[:, 3:], [x + w, y + h]) - np.maximum(boxes[:, 1:3], [x, y])
    return np.clip(sides, 0, None).prod(1) / np.prod(boxes[:, 3:] - boxes[:, 1:3], axis=1)


def fog(image: NDArray, transmission: float, veil: NDArray) -> NDArray[np.uint8]:
    """Beer-Lambert: what is left of the image plus the light scattered on the way."""
    table = np.clip(np.arange(256)[:, None] * transmission + (1.0 - transmission) * veil, 0, 255)
    return cv2.LUT(np.clip(image, 0, 255).astype(np.uint8), table.astype(np.uint8)[None])


def outlined(sprite: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A sprite cut to its outline, where it has one of three pixels or more."""
    rows, columns = np.flatnonzero((sprite[..., 3] > 50).any(1)), np.flatnonzero((sprite[..., 3] > 50).any(0))
    if min(rows.size, columns.size) < 3:
        return sprite
    return sprite[rows[0]:rows[-1] + 1, columns[0]:columns[-1] + 1]


def tilt(sprite: NDArray[np.uint8], degrees: float) -> NDArray[np.uint8]:
    """A sprite turned in the image and cut to its outline again."""
    h, w = sprite.shape[:2]
    turn = cv2.getRotationMatrix2D((w / 2, h / 2), degrees, 1.0)
    wide = int(np.hypot(h, w)) + 2
    turn[:, 2] += 0.5 * wide - np.array([w, h]) / 2
    return outlined(cv2.warpAffine(sprite, turn, (wide, wide)))
