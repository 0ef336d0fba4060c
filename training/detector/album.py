"""Windows of other people's pictures at any zoom, and mosaics of them."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from painted import Rng, log_uniform
from places import SOURCES, Picture, pictures

Sample = tuple[NDArray[np.uint8], NDArray[np.float32]]
# How often each place is drawn: by how much there is to see in it, not by its number of pictures.
SHARES = {'flying': 0.35, 'perched': 0.33, 'woods': 0.16, 'hackathon': 0.16}
WHOLE = 0.35   # share of the views that show the whole picture, as the detector gets it
MOSAIC = 0.3   # share of the samples that are four views: far things without enlarging any
LEAST = 7.0    # pixels, the smallest an object becomes
LARGEST_ZOOM = 2.5
LEFT = 0.3     # share of an object that must be left inside


class Album:
    """The pictures of the places that may be trained on but those left out, drawn by place, then by source."""

    def __init__(self, cache: Path, left_out: tuple[str, ...] = ()) -> None:
        self._places: list[list[list[Picture]]] = []
        shares = []
        for place in SOURCES:
            if place.name in left_out:
                continue
            by_source: dict[str, list[Picture]] = defaultdict(list)
            for picture in pictures(place, cache):
                by_source[picture.source].append(picture)
            self._places.append(list(by_source.values()))
            shares.append(SHARES[place.name])
        self._shares = np.array(shares) / max(sum(shares), 1e-9)

    def __len__(self) -> int:
        return sum(len(sources) for sources in self._places)

    def draw(self, rng: Rng, side: int) -> Sample:
        """A view of a picture, or four of half the side, as an image (side, side, 3) and its boxes (k, 5)."""
        if side < 256 or rng.random() >= MOSAIC:
            return self.view(rng, side)
        image, boxes = np.empty((side, side, 3), np.uint8), []
        left, top = (round(side * rng.uniform(0.35, 0.65)) for _ in range(2))
        for x1, x2 in ((0, left), (left, side)):
            for y1, y2 in ((0, top), (top, side)):
                part, there = self.view(rng, max(x2 - x1, y2 - y1))
                image[y1:y2, x1:x2] = part[:y2 - y1, :x2 - x1]
                boxes.append(cut(there, x2 - x1, y2 - y1) + np.array([0, x1, y1, x1, y1], np.float32))
        return image, np.concatenate(boxes)

    def view(self, rng: Rng, side: int, least: float = LEAST) -> Sample:
        """A view of one picture; an object that is zoomed to becomes `least` pixels or larger."""
        sources = self._places[rng.choice(len(self._places), p=self._shares)]
        versions = sources[rng.integers(len(sources))]
        picture = versions[rng.integers(len(versions))]
        return view_of(rng, *picture.load(), side, least)


def view_of(rng: Rng, image: NDArray[np.uint8], boxes: NDArray[np.float32], side: int, least: float = LEAST) -> Sample:
    """The whole picture or a window around one of its objects, at which zoom ever; what is outside is of one colour."""
    height, width = image.shape[:2]
    whole = side / max(height, width)
    zoom, centre = whole * rng.uniform(0.75, 1.0), np.array([0.5 * width, 0.5 * height])
    if rng.random() >= WHOLE:
        some = boxes[rng.integers(len(boxes))] if len(boxes) and rng.random() < 0.9 else None
        size = 0.25 * max(height, width) if some is None else float((some[3:] - some[1:3]).max())
        # Not much less than the whole picture's: the window would be mostly empty.
        zoom = float(np.clip(log_uniform(rng, least, 0.95 * side) / size, 0.8 * whole, LARGEST_ZOOM))
        centre = rng.uniform([0, 0], [width, height]) if some is None else 0.5 * (some[1:3] + some[3:])
    window = side / zoom
    # As much of the picture as there is room for, the object anywhere in it.
    corner = centre - window * rng.uniform(0.15, 0.85, 2)
    room = np.array([width, height]) - window
    corner = np.where(room > 0, np.clip(corner, 0, np.maximum(room, 0)), rng.uniform(np.minimum(room, 0), 1e-6))
    move = np.array([[zoom, 0, -zoom * corner[0]], [0, zoom, -zoom * corner[1]]])
    grey = rng.random() < 0.5
    colour = (114.0,) * 3 if grey else image[rng.integers(height), rng.integers(width)].astype(float).tolist()
    if zoom < 0.7:  # warpAffine alone would alias
        small = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA)
        move[:, :2] = np.eye(2)
        view = cv2.warpAffine(small, move, (side, side), flags=cv2.INTER_LINEAR, borderValue=colour)
    else:
        view = cv2.warpAffine(image, move, (side, side), flags=cv2.INTER_LINEAR, borderValue=colour)
    moved = boxes.copy()
    moved[:, 1:] = (boxes[:, 1:] - np.tile(corner, 2)) * zoom
    return view, cut(moved, side, side)


def cut(boxes: NDArray[np.float32], width: int, height: int) -> NDArray[np.float32]:
    """Boxes (k, 5) cut at an image's edge; those of which too little is left go."""
    inside = boxes.copy()
    inside[:, 1:] = np.clip(boxes[:, 1:], 0, [width, height] * 2)
    areas = [np.prod(some[:, 3:] - some[:, 1:3], axis=1) for some in (inside, boxes)]
    return inside[areas[0] >= LEFT * np.maximum(areas[1], 1e-6)].astype(np.float32)
