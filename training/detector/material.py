"""What training crops take from the real images: places that are not plain sky, objects cut out of it."""

from __future__ import annotations

import numpy as np
from clips import CLASSES, HEIGHT, WIDTH, Frames
from numpy.typing import NDArray
from pasting import outlined
from tight import padded, standing_out

BLOCK, CROWD, LEAST = 64, 12.0, 20  # pixels, spread of grey, blocks of a clip
CUTOUTS = 12  # of each clip
ROUND = np.array([8.0, 8.0], np.float32)  # pixels of sky around an object that is cut out
DARK = 90  # grey of walls and woods


def crowded_places(frames: Frames) -> list[NDArray[np.intp]]:
    """For each clip that has any, places (k, 3) of frame, x, y where woods, fields or houses are: most of it all is sky."""
    made: dict[str, list[NDArray[np.intp]]] = {}
    for i in range(0, len(frames), 3):
        blocks = frames.image(i)[..., 1].reshape(HEIGHT // BLOCK, BLOCK, WIDTH // BLOCK, BLOCK)[:, ::2, :, ::2]
        rows, columns = np.nonzero(blocks.std(axis=(1, 3)) > CROWD)
        centres = np.stack([np.full(len(rows), i), columns * BLOCK + BLOCK // 2, rows * BLOCK + BLOCK // 2], axis=1)
        made.setdefault(frames.clips[i], []).append(centres)
    return [places for places in map(np.concatenate, made.values()) if len(places) >= LEAST]


def cutouts(frames: Frames) -> list[list[NDArray[np.uint8]]]:
    """For each class the objects (h, w, 4) BGRA, sides of their boxes, that stand before a sky plain enough to cut them out.

    What differs from the colour around the box is the object.
    """
    made: list[list[NDArray[np.uint8]]] = [[] for _ in CLASSES]
    of_clip: dict[str, list[int]] = {}
    for i, clip in enumerate(frames.clips):
        of_clip.setdefault(clip, []).append(i)
    for rows in of_clip.values():
        for i in rows[::max(len(rows) // CUTOUTS, 1)]:
            for label, *box in frames.boxes[i]:
                crop, off = standing_out(frames.image(i), padded(np.array(box), ROUND))
                if min(crop.shape[:2]) < 8 or off is None:
                    continue
                sprite = np.dstack([crop, np.clip((off - 10.0) * 8.0, 0, 255)]).astype(np.uint8)
                made[int(label)].append(outlined(sprite))
    return made


def before_dark(frames: Frames, i: int) -> bool:
    """Whether there is something dark around any object of a frame."""
    for x1, y1, x2, y2 in np.rint(frames.boxes[i][:, 1:]).astype(int):
        around = frames.image(i)[max(y1 - 4, 0):y2 + 4, max(x1 - 4, 0):x2 + 4].mean(axis=2)
        rim = np.concatenate([around[:3].ravel(), around[-3:].ravel(), around[:, :3].ravel(), around[:, -3:].ravel()])
        if np.percentile(rim, 10) < DARK:
            return True
    return False
