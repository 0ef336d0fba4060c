"""Training crops for the near pass and the second look: other people's pictures, and what far objects of the clips look like.

The near pass shows the network whole pictures, the second look a small window around each thing that the first network found
(`av_vision.yolo.detector`), enlarged so far that a speck fills a third of it.
"""

from __future__ import annotations

import cv2
import numpy as np
from album import Album, cut
from clips import Frames
from material import crowded_places
from numpy.typing import NDArray
from painted import Rng, log_uniform
from samples import Sample, finish

INPUT = 320          # pixels of the longer side
LEAST_SHARE = 0.06  # of the crop's side: what is smaller is for the pass over sharp crops, and counts for nothing here
CLIPS = 0.5         # share of the crops that show clips
KINDS = {'DRONE': 0.4, 'BIRD': 0.2, 'AIRPLANE': 0.2, 'HELICOPTER': 0.08}  # the rest: places without an object
CONTEXT = (2.0, 5.0)  # side of a window in sizes of its object
LEAST_SIDE, LARGEST_SIDE = 24.0, 120.0  # pixels of a window without an object


class NearSampler:
    """Makes labelled crops; the same generator makes the same crop.

    Parameters:
        album: the pictures.
        frames: frames of the clips; None for pictures alone.
    """

    def __init__(self, album: Album, frames: Frames | None = None) -> None:
        self._album, self._frames = album, frames
        self._crowded = crowded_places(frames) if frames else []
        self._clips: dict[str, dict[str, list[int]]] = {kind: {} for kind in KINDS}
        for i, clip in enumerate(frames.clips if frames else ()):
            if len(frames.boxes[i]):
                self._clips[clip.split('_')[1]].setdefault(clip, []).append(i)

    def draw(self, rng: Rng, side: int) -> Sample:
        """One crop of side x side, labels (k, 5): class, x1, y1, x2, y2 in pixels of the crop."""
        if self._frames is None or rng.random() >= CLIPS:
            return finish(rng, *self._album.view(rng, side, LEAST_SHARE * side))
        return finish(rng, *self._from_clip(rng, self._frames, side))

    def _from_clip(self, rng: Rng, frames: Frames, side: int) -> Sample:
        """A window around an object, of every clip equally often, or of woods, fields and houses."""
        kind = rng.choice([*KINDS, ''], p=[*KINDS.values(), 1.0 - sum(KINDS.values())])
        if kind:
            clips = list(self._clips[kind].values())
            some = clips[rng.integers(len(clips))]
            i = some[rng.integers(len(some))]
            box = frames.boxes[i][rng.integers(len(frames.boxes[i])), 1:]
            extent = max(log_uniform(rng, *CONTEXT) * float((box[2:] - box[:2]).max()), LEAST_SIDE)
            centre = 0.5 * (box[:2] + box[2:]) + rng.uniform(-0.2, 0.2, 2) * extent
        else:
            i, *place = rng.choice(self._crowded[rng.integers(len(self._crowded))])
            extent, centre = log_uniform(rng, LEAST_SIDE, LARGEST_SIDE), np.array(place) + rng.uniform(-32, 32, 2)
        return window(frames.image(int(i)), frames.boxes[int(i)], centre, extent, side)


def window(image: NDArray[np.uint8], boxes: NDArray[np.float32], centre: NDArray, extent: float, side: int) -> Sample:
    """A square of `extent` pixels around a place as an image (side, side, 3), and the boxes (k, 5) in it."""
    zoom, corner = side / extent, centre - 0.5 * extent
    move = np.array([[zoom, 0.0, -zoom * corner[0]], [0.0, zoom, -zoom * corner[1]]])
    view = cv2.warpAffine(image, move, (side, side), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    moved = boxes.copy()
    moved[:, 1:] = (boxes[:, 1:] - np.tile(corner, 2)) * zoom
    return np.asarray(view, np.uint8), cut(moved, side, side)
