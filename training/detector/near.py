"""Training crops for the near pass: whole pictures of the places, and windows around what is large in them."""

from __future__ import annotations

from album import Album, Sample
from painted import Rng
from samples import finish

INPUT = 320          # pixels of the longer side
LEAST_SHARE = 0.06  # of the crop's side: what is smaller is for the pass over sharp crops, and counts for nothing here


class NearSampler:
    """Makes labelled crops of pictures; the same generator makes the same crop.

    Parameters:
        album: the pictures.
    """

    def __init__(self, album: Album) -> None:
        self._album = album

    def draw(self, rng: Rng, side: int) -> Sample:
        """One crop of side x side, labels (k, 5): class, x1, y1, x2, y2 in pixels of the crop."""
        return finish(rng, *self._album.view(rng, side, LEAST_SHARE * side))
