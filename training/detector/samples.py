"""Training images: windows of real frames at any zoom, painted skies, pasted renders, fog, blur and light."""

from __future__ import annotations

import cv2
import numpy as np
from album import Album, Sample, cut
from clips import CLASSES, HEIGHT, WIDTH, Frames, scaled
from material import before_dark, crowded_places, cutouts
from numpy.typing import NDArray
from painted import Rng, branches, log_uniform, painted_background
from pasting import fog, paste

cv2.setNumThreads(1)  # the network has the cores
PAINTED, BRANCHES = 120, 150  # images
MIXTURE = {'DRONE': 0.10, 'BIRD': 0.06, 'AIRPLANE': 0.09, 'HELICOPTER': 0.05, 'CROWDED': 0.13, 'PAINTED': 0.02,
           'SIMULATED': 0.10, 'ELSEWHERE': 0.45}
ENLARGED = 0.45  # share of the crops
SCALES = (1.25, 1.6, 2.0, 2.25, 2.5, 3.0)  # of images and tiles, as the detector enlarges them
CROWDED = 0.75  # share of the renders that are pasted where there is something behind them
BEFORE_DARK = 0.7  # share of the simulator's crops with a drone before something dark
OTHERS = 52.0  # pixels, as the network sees them, from which on other things than drones are pasted
Bank = dict[str, list[NDArray[np.uint8]]]


class Sampler:
    """Makes labelled crops from frames and sprites; the same generator makes the same crop.

    Labels are (k, 5): class, x1, y1, x2, y2 in pixels of the crop.
    """

    def __init__(self, frames: Frames, bank: Bank, simulated: Frames | None = None, album: Album | None = None) -> None:
        self._frames, self._simulated, self._album = frames, simulated, album
        self._sprites = [bank[kind] for kind in CLASSES]
        self._others = bank['other']
        self._branches = [branches(np.random.default_rng([number, 4])) for number in range(BRANCHES)]
        self._painted_before: dict[int, NDArray[np.uint8]] = {}
        # Clips in which a class is rare are drawn as often as the others.
        kinds = np.array([clip.split('_')[1] for clip in frames.clips])
        self._by_kind = {kind: np.flatnonzero(kinds == kind) for kind in np.unique(kinds)}
        self._cutouts = cutouts(frames)
        self._crowded = crowded_places(frames)
        # A dark drone before a dark wall or wood is the hardest to find.
        dark = np.array([before_dark(simulated, i) for i in range(len(simulated))]) if simulated else np.zeros(0, bool)
        self._before_dark = np.flatnonzero(dark if dark.any() else ~dark)
        self._before_light = np.flatnonzero(dark if dark.all() else ~dark)
        there = {'CROWDED': bool(self._crowded), 'PAINTED': True, 'SIMULATED': bool(len(dark)),
                 'ELSEWHERE': bool(album)}
        self._kinds = [kind for kind in MIXTURE if there.get(kind, kind in self._by_kind)]
        shares = np.array([MIXTURE[kind] for kind in self._kinds])
        self._shares = shares / shares.sum()

    def draw(self, rng: Rng, side: int) -> Sample:
        """One crop of side x side; some, and all larger than a frame, are enlarged: what is small may be blurred, too."""
        if side <= HEIGHT and rng.random() >= ENLARGED:
            return finish(rng, *self._compose(rng, side))
        smaller = round(side / rng.choice([scale for scale in SCALES if side / scale <= HEIGHT]))
        image, boxes = self._compose(rng, smaller, side / smaller)
        return finish(rng, cv2.resize(image, (side, side), interpolation=cv2.INTER_LINEAR), scaled(boxes, side / smaller))

    def _compose(self, rng: Rng, side: int, scale: float = 1.0) -> Sample:
        """A window of a frame with what is pasted into it, to be enlarged by `scale`."""
        kind = rng.choice(self._kinds, p=self._shares)
        if kind == 'PAINTED':
            image, boxes = self._painted(rng, side), np.empty((0, 5), np.float32)
        elif kind == 'SIMULATED':
            some = self._before_dark if rng.random() < BEFORE_DARK else self._before_light
            image, boxes = window_of(rng, self._simulated, int(rng.choice(some)), side)
        elif kind == 'ELSEWHERE':
            image, boxes = self._album.draw(rng, side)
        elif kind == 'CROWDED':
            i, *centre = rng.choice(self._crowded[rng.integers(len(self._crowded))])
            image, boxes = window_of(rng, self._frames, int(i), side, np.array(centre))
        else:
            image, boxes = window_of(rng, self._frames, int(rng.choice(self._by_kind[kind])), side)
        clearness = np.exp(-rng.exponential(0.8)) if rng.random() < 0.2 else 1.0
        veil = np.full(3, rng.uniform(110, 240)) + rng.uniform(-12, 12, 3)
        if clearness < 1.0:
            image = fog(image, clearness, veil)
        boxes = self._paste_drones(rng, image, boxes, clearness, veil, scale)
        return image, self._paste_others(rng, image, boxes, clearness, veil, scale)

    def _paste_drones(self, rng: Rng, image: NDArray, boxes: NDArray, clearness: float, veil: NDArray,
                      scale: float) -> NDArray[np.float32]:
        """Paste rendered drones: at every size up to twice as many as other things.

        To take another thing for a drone costs double (`loss.CONFUSED`); where fewer drones are shown, drones score low.
        """
        side = scale * len(image)  # sizes are meant as the network sees them
        if rng.random() < (0.7 if side < 400 else 0.8):
            for _ in range(1 + (rng.random() < 0.35)):
                nearer = clearness ** rng.uniform(0.15, 1.0)
                # Large crops are few, and only they hold near drones.
                most = 0.9 * side if side >= 200 or rng.random() < 0.5 else 40.0
                least = 6.0 if side < 200 else 7.0
                size = log_uniform(rng, max(least / scale, 6.0), most / scale)
                boxes = paste(rng, image, boxes, self._sprites[0], size, nearer, veil, 0, rng.random() < CROWDED)
        return boxes

    def _paste_others(self, rng: Rng, image: NDArray, boxes: NDArray, clearness: float, veil: NDArray,
                      scale: float) -> NDArray[np.float32]:
        """Paste what flies besides rendered drones, what was cut out of other frames, branches and other things."""
        side, least = len(image), OTHERS / scale
        # Nothing tells the smaller apart: only drones are pasted so small; how often they are drones the clips have to teach.
        if rng.random() < 0.1:  # airplanes above all: lit by the sun they are most like drones
            label = int(rng.choice([1, 2, 3], p=[0.2, 0.65, 0.15]))
            size = log_uniform(rng, least, 0.6 * side)
            boxes = paste(rng, image, boxes, self._sprites[label], size, clearness, veil, label, rng.random() < CROWDED)
        if rng.random() < 0.3:  # a real one before another sky, nearer or further than it was filmed
            label = int(rng.choice(len(self._cutouts), p=[0.5, 0.15, 0.25, 0.1]))
            size = log_uniform(rng, least if label else 5.0, 0.5 * side)
            boxes = paste(rng, image, boxes, self._cutouts[label], size, clearness, veil, label)
        if rng.random() < 0.12:
            for _ in range(rng.integers(1, 4)):
                size = log_uniform(rng, 0.3 * side, 0.95 * side)
                boxes = paste(rng, image, boxes, self._branches, size, clearness, veil, None)
        if rng.random() < 0.05:
            boxes = paste(rng, image, boxes, self._others, log_uniform(rng, least, 0.7 * side), clearness, veil, None)
        return boxes

    def _painted(self, rng: Rng, side: int) -> NDArray[np.uint8]:
        """A window of one of the painted backgrounds, which are made when first asked for."""
        number = int(rng.integers(PAINTED))
        if number not in self._painted_before:
            self._painted_before[number] = painted_background(np.random.default_rng([number, 3]), 512)
        x, y = rng.integers(0, 513 - side, 2)
        return self._painted_before[number][y:y + side, x:x + side].copy()


def window_of(rng: Rng, frames: Frames, i: int, side: int, centre: NDArray | None = None) -> Sample:
    """A window of a frame, scaled by 0.5 to 3: around a place (x, y), or without one around an object nine times in ten."""
    frame, boxes = frames.image(i), frames.boxes[i]
    zoom = max(log_uniform(rng, 0.5, 3.0), 1.02 * side / HEIGHT)
    if len(boxes):  # no object may outgrow the crop
        zoom = min(zoom, max(0.9 * side / (boxes[:, 3:] - boxes[:, 1:3]).max(), 1.02 * side / HEIGHT))
    if rng.random() < 0.5 and side < HEIGHT:
        zoom = min(zoom, 1.0) if len(boxes) and (boxes[:, 3:] - boxes[:, 1:3]).max() > 0.9 * side else 1.0
    window = min(side / zoom, HEIGHT)
    low, high = np.zeros(2), np.array([WIDTH, HEIGHT]) - window
    if centre is None and len(boxes) and rng.random() < 0.9:
        box = boxes[rng.integers(len(boxes))]
        centre = 0.5 * (box[1:3] + box[3:5])
    if centre is not None:
        low, high = np.clip(centre - 0.9 * window, 0, high), np.clip(centre - 0.1 * window, 0, high)
    corner = np.floor(rng.uniform(low, high + 1e-6))
    extent = round(window)
    x, y = corner.astype(int)
    crop = frame[y:y + extent, x:x + extent]
    scale = side / np.array(crop.shape[1::-1], float)
    image = cv2.resize(crop, (side, side), interpolation=cv2.INTER_AREA if zoom < 1 else cv2.INTER_LINEAR)
    moved = boxes - np.array([0, x, y, x, y], np.float32)
    return image, cut(scaled(moved, float(scale.mean())), side, side)


def visible(image: NDArray[np.uint8], box: NDArray) -> bool:
    """Whether anything stands out in a box."""
    x1, y1, x2, y2 = np.rint(box).astype(int)
    part = image[y1:y2, x1:x2]
    return part.size > 0 and float(np.ptp(np.percentile(part, [1, 99]))) > 6.0


def finish(rng: Rng, image: NDArray[np.uint8], boxes: NDArray[np.float32]) -> Sample:
    """What happens between the scene and the file: mirror, light, colour, blur, noise, JPEG."""
    side = image.shape[0]
    if rng.random() < 0.5:
        image = image[:, ::-1]
        boxes = boxes[:, [0, 3, 2, 1, 4]] * [1, -1, 1, -1, 1] + np.array([0, side, 0, side, 0])
    if rng.random() < 0.7:
        gain, gamma, tint = rng.uniform(0.65, 1.2), np.exp(rng.normal(0, 0.3)), rng.uniform(0.88, 1.12, 3)
        table = np.clip(255 * gain * tint * (np.arange(256)[:, None] / 255.0) ** gamma + rng.uniform(-15, 15), 0, 255)
        image = cv2.LUT(image, table.astype(np.uint8)[None])
    if rng.random() < 0.08:
        image = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    if rng.random() < 0.12:
        image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.4, 1.2))
    elif rng.random() < 0.08:
        length = int(rng.integers(3, 8))
        kernel = np.zeros((length, length))
        kernel[length // 2] = 1.0
        turn = cv2.getRotationMatrix2D((length / 2, length / 2), rng.uniform(0, 180), 1)
        kernel = cv2.warpAffine(kernel, turn, (length, length))
        image = cv2.filter2D(image, -1, kernel / max(kernel.sum(), 1e-6))
    boxes = boxes[[visible(image, box[1:]) for box in boxes]] if len(boxes) else boxes
    if rng.random() < 0.2:
        grain = np.empty(image.shape, np.int16)
        cv2.setRNGSeed(int(rng.integers(2**31)))
        cv2.randn(grain, (0, 0, 0), (rng.uniform(1, 9),) * 3)
        image = cv2.add(image, grain, dtype=cv2.CV_8U)
    if rng.random() < 0.2:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(35, 95))]
        image = cv2.imdecode(cv2.imencode('.jpg', np.ascontiguousarray(image), quality)[1], cv2.IMREAD_COLOR)
    return np.ascontiguousarray(image), boxes.astype(np.float32)
