"""A part of an image that a network is given."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Region(NamedTuple):
    """A part of an image that is searched.

    Parameters:
        kind: full, near, track, bearing or tile.
        x, y (pixels): top-left corner.
        width, height (pixels): its size.
        longest (pixels): its longer side as input of the network.
        least (pixels): larger side of the smallest object that counts; smaller ones are found elsewhere.
    """

    kind: str
    x: int
    y: int
    width: int
    height: int
    longest: int
    least: float = 0.0

    def holds(self, centre: NDArray, size: float) -> bool:
        """Whether an object would have been found here.

        Parameters:
            centre (2,; pixels): its centre.
            size (pixels): its larger side.
        """
        low, high = np.asarray(centre) - 0.5 * size, np.asarray(centre) + 0.5 * size
        return bool(np.all(low >= (self.x, self.y)) and np.all(high <= (self.x + self.width, self.y + self.height))
                    and size >= self.least)
