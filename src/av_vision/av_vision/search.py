"""Where to look in an image: cheap regions one after the other instead of the whole image at full resolution.

A network takes time in proportion to the pixels that it is given. Few of them matter: those around a track or a bearing of the
fusion. The target comes first: the most likely track, or the bearing. The rest is searched tile by tile over several images,
and the whole image at low resolution for large objects. Each of these cues falls due after its own period; the most overdue
ones are looked at (earliest deadline first, relative to the period). All times are capture times, so that a sequence of images
gives the same regions again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_vision.yolo.letterbox import Region, tile_corners

SMOOTHING = 0.1  # weight of the newest search in means
CROP_INPUT, TILE_INPUT = 320, 416  # pixels to which regions are enlarged
OVERLAP = 0.2                      # share of a tile that is common with its neighbour
CONTEXT = 3.0                      # side of a crop in units of its object
TRACK_S, BEARING_S, NEAR_S, SWEEP_S = 0.06, 0.15, 0.25, 1.5  # periods of the cues
SEARCHED_S = 2.0                   # age of the oldest look at a tile up to which the whole image counts as searched
ASIDE = 4                          # where there is time for one region, each so manieth image is for all but the target
FULL = 11                          # regions that take as long as the whole image at full resolution
SIGMAS = 2.0                       # half width of a bearing's crop in standard deviations


class Cue(NamedTuple):
    """A place at which something may be.

    Parameters:
        centre (2,; pixels): the place.
        size (pixels): of the object.
        age (s): time since the last look at it.
        is_target: whether it is reported, so that not to look there would be taken for its absence.
    """

    centre: NDArray
    size: float
    age: float
    is_target: bool = False


class BearingCue(NamedTuple):
    """Where a bearing is in the image.

    Parameters:
        centre (2,; pixels): the place.
        sigma (2,; pixels): standard deviations; inf for an unknown row.
    """

    centre: NDArray
    sigma: NDArray


class RegionPlanner:
    """Selects the regions of each image.

    Attributes:
        regions: number of regions in an image; from FULL on the whole image is searched instead.
        planned: number of regions of the last image, 0 for all of it.
        share: of the image that is searched for small objects, mean over the last images.

    Parameters:
        longest (pixels): longer side of the whole image as input; regions are enlarged as much, or not at all.
        near (pixels): longer side of the whole image where it is searched for large objects.
        regions: number of regions in an image.
        look_time (s): time for one image, to which `took` adapts their number; 0 keeps it.
    """

    def __init__(self, longest: int, near: int, regions: int = 2, look_time: float = 0.0) -> None:
        self.regions = regions
        self._look_time, self._each = look_time, 0.0  # s, of an image and of a region
        self.planned = 0
        self.share = 1.0
        self._longest, self._near = longest, near
        self.reset()

    def reset(self) -> None:
        """Begin with the whole image again."""
        self._shape = (0, 0)
        self._tiles: list[tuple[int, int]] = []
        self._looked = np.empty(0)  # when each tile was looked at
        self._last: dict[str, float] = {}
        self._images = 0

    def plan(self, shape: tuple[int, int], time: float, tracks: Sequence[Cue],
             bearing: BearingCue | None = None) -> list[Region]:
        """The regions of an image; none for the whole of it, at full resolution.

        Parameters:
            shape (pixels): height and width.
            time (s): capture time.
            tracks: tracked objects, the most important first.
            bearing: the fused bearing in the image; None where it is outside or unknown.
        """
        if shape != self._shape or time < max(self._last.values(), default=-math.inf) or self.regions >= FULL:
            self._begin(shape, time)
            self.planned = 0
            self._note_share(1.0)
            return []
        followed = [(one.age / TRACK_S, self._crop('track', one.centre, CONTEXT * one.size)) for one in tracks]
        cues = self._due_cues(time, bearing)
        due = sorted([*followed, *self._due_tiles(time, bearing), *cues], key=lambda one: -one[0])
        targets = [one for one, cue in zip(followed, tracks, strict=True) if cue.is_target]
        target = max(targets, key=lambda one: one[0], default=next(
            (one for one in (*followed, *cues) if one[1].kind in ('track', 'bearing')), None))
        self._images += 1
        if target is not None:
            due.remove(target)
            due.insert(self.regions == 1 and self._images % ASIDE == 0, target)
        regions = [region for _, region in due[:self.regions]]
        for region in regions:
            self._last[region.kind] = time
            if region.kind == 'tile':
                self._looked[self._tiles.index((region.x, region.y))] = time
        self.planned = len(regions)
        self._note_share(sum(region.width * region.height for region in regions if not region.least) / (shape[0] * shape[1]))
        return regions

    def took(self, duration: float) -> None:
        """Adapt the number of regions, 1 to FULL, to the duration (s) of the last image."""
        if self._look_time > 0.0:
            each = duration / (self.planned or FULL)
            self._each += (SMOOTHING if self._each else 1.0) * (each - self._each)
            self.regions = int(np.clip(self._look_time / max(self._each, 1e-6), 1, FULL))

    def searched(self, time: float) -> bool:
        """Whether every part of the image has been looked at recently, at a capture time (s)."""
        return bool(time - self._looked.min(initial=time) <= SEARCHED_S)

    def _note_share(self, share: float) -> None:
        self.share += SMOOTHING * (min(share, 1.0) - self.share)

    def _begin(self, shape: tuple[int, int], time: float) -> None:
        self._shape = shape
        height, width = shape
        self._scale = max(self._longest / max(shape), 1.0)
        self._side = max(round(TILE_INPUT / self._scale), 1)  # of a tile, in pixels of the image
        self._tiles = tile_corners(width, height, self._side, OVERLAP)
        self._looked = np.full(len(self._tiles), time)
        self._last = dict.fromkeys(('near', 'bearing'), time)

    def _due_cues(self, time: float, bearing: BearingCue | None) -> list[tuple[float, Region]]:
        height, width = self._shape
        # What no tile is sure to hold whole.
        near = Region('near', 0, 0, width, height, self._near, OVERLAP * self._side)
        due = [((time - self._last['near']) / NEAR_S, near)]
        if bearing is not None and np.isfinite(bearing.sigma).all():
            side = 2.0 * SIGMAS * bearing.sigma.max() + CROP_INPUT / self._scale
            due.append(((time - self._last['bearing']) / BEARING_S, self._crop('bearing', bearing.centre, side)))
        return due

    def _due_tiles(self, time: float, bearing: BearingCue | None) -> list[tuple[float, Region]]:
        height, width = self._shape
        side, period = self._side, np.full(len(self._tiles), SWEEP_S)
        if bearing is not None and not np.isfinite(bearing.sigma).all():  # the row is unknown: one tile of the column
            middle = np.array(self._tiles)[:, 0] + 0.5 * side
            near = np.abs(middle - bearing.centre[0]) <= 0.5 * side + SIGMAS * bearing.sigma[0]
            period[near] = BEARING_S * max(int(near.sum()), 1)
        return [(age, Region('tile', x, y, min(side, width), min(side, height), TILE_INPUT))
                for age, (x, y) in zip((time - self._looked) / period, self._tiles, strict=True)]

    def _crop(self, kind: str, centre: NDArray, side: float) -> Region:
        """A square around a place, moved into the image, at the scale of the whole image or less."""
        height, width = self._shape
        wanted = max(round(CROP_INPUT / self._scale), math.ceil(side))
        across, down = min(wanted, width), min(wanted, height)
        x = int(np.clip(round(centre[0] - 0.5 * across), 0, width - across))
        y = int(np.clip(round(centre[1] - 0.5 * down), 0, height - down))
        return Region(kind, x, y, across, down, CROP_INPUT)
