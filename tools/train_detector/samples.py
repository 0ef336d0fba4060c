"""Training pictures: windows of real frames at any zoom, painted skies, pasted renders, fog, blur and light."""

from __future__ import annotations

import cv2
import numpy as np
from clips import CLASSES, HEIGHT, WIDTH, Frames
from numpy.typing import NDArray

Rng = np.random.Generator
Sample = tuple[NDArray[np.uint8], NDArray[np.float32]]
cv2.setNumThreads(1)  # the network has the cores
PAINTED = 120  # backgrounds
MIXTURE = {'DRONE': 0.2, 'BIRD': 0.2, 'AIRPLANE': 0.22, 'HELICOPTER': 0.1, 'PAINTED': 0.06, 'SIMULATED': 0.22}
CUTOUTS = 12  # of each clip
Bank = dict[str, list[NDArray[np.uint8]]]


class Sampler:
    """Makes labelled squares from frames and sprites; the same generator makes the same square.

    Labels are (k, 5): class, x1, y1, x2, y2 in pixels of the square.
    """

    def __init__(self, frames: Frames, bank: Bank, simulated: Frames | None = None, use: str = 'train') -> None:
        self._frames, self._simulated = frames, simulated
        self._drones, self._others = bank[f'{use}/drone'], bank[f'{use}/other']
        self._painted_before: dict[int, NDArray[np.uint8]] = {}
        # Clips in which a class is rare are drawn as often as the others.
        kinds = np.array([clip.split('_')[1] for clip in frames.clips])
        self._by_kind = {kind: np.flatnonzero(kinds == kind) for kind in np.unique(kinds)}
        self._cutouts = cutouts(frames)

    def draw(self, rng: Rng, side: int) -> Sample:
        """One square of side x side."""
        kind = rng.choice(list(MIXTURE), p=list(MIXTURE.values()))
        if kind == 'PAINTED':
            image, boxes = self._painted(rng, side), np.empty((0, 5), np.float32)
        elif kind == 'SIMULATED':
            image, boxes = window_of(rng, self._simulated, int(rng.integers(len(self._simulated))), side)
        else:
            image, boxes = window_of(rng, self._frames, int(rng.choice(self._by_kind[kind])), side)
        clearness = np.exp(-rng.exponential(0.8)) if rng.random() < 0.2 else 1.0
        veil = np.full(3, rng.uniform(110, 240)) + rng.uniform(-12, 12, 3)
        if clearness < 1.0:
            image = fog(image, clearness, veil)
        # Large squares are few, and only they hold near drones.
        if rng.random() < (0.75 if kind == 'PAINTED' else 0.15 if side < 256 else 0.35):
            for _ in range(1 + (rng.random() < 0.15)):
                nearer = clearness ** rng.uniform(0.15, 1.0)
                boxes = paste(rng, image, boxes, self._drones, log_uniform(rng, 6.0, min(0.95 * side, 320.0)), nearer, veil, 0)
        if rng.random() < 0.3:  # a real one before another sky, nearer or further than it was filmed
            label = int(rng.choice(len(self._cutouts), p=[0.25, 0.25, 0.35, 0.15]))
            boxes = paste(rng, image, boxes, self._cutouts[label], log_uniform(rng, 10.0, 0.6 * side), clearness, veil, label)
        if rng.random() < 0.15:
            boxes = paste(rng, image, boxes, self._others, log_uniform(rng, 6.0, 0.7 * side), clearness, veil, None)
        return finish(rng, image, boxes)

    def _painted(self, rng: Rng, side: int) -> NDArray[np.uint8]:
        """A window of one of the painted backgrounds, which are made when first asked for."""
        number = int(rng.integers(PAINTED))
        if number not in self._painted_before:
            self._painted_before[number] = painted_background(np.random.default_rng([number, 3]), 512)
        x, y = rng.integers(0, 512 - side, 2)
        return self._painted_before[number][y:y + side, x:x + side].copy()


def cutouts(frames: Frames) -> list[list[NDArray[np.uint8]]]:
    """For each class the objects (h, w, 4) BGRA, sides of their boxes, that stand before a sky plain enough to cut them out.

    What differs from the colour around the box is the object; the box stays as loose as the label.
    """
    made: list[list[NDArray[np.uint8]]] = [[] for _ in CLASSES]
    of_clip: dict[str, list[int]] = {}
    for i, clip in enumerate(frames.clips):
        of_clip.setdefault(clip, []).append(i)
    for rows in of_clip.values():
        for i in rows[::max(len(rows) // CUTOUTS, 1)]:
            for label, *box in frames.boxes[i]:
                x1, y1, x2, y2 = np.rint(np.clip(box, 0, [WIDTH, HEIGHT] * 2)).astype(int)
                around = frames.image(i)[max(y1 - 4, 0):y2 + 4, max(x1 - 4, 0):x2 + 4].astype(np.float32)
                rim = np.concatenate([around[:4].reshape(-1, 3), around[-4:].reshape(-1, 3), around[:, :4].reshape(-1, 3)])
                if min(x2 - x1, y2 - y1) < 8 or rim.std(axis=0).max() > 6.0:
                    continue
                crop = frames.image(i)[y1:y2, x1:x2]
                off = np.abs(crop - np.median(rim, axis=0)).max(axis=2)
                made[int(label)].append(np.dstack([crop, np.clip((off - 10.0) * 8.0, 0, 255)]).astype(np.uint8))
    return made


def window_of(rng: Rng, frames: Frames, i: int, side: int) -> Sample:
    """A window of a frame, around an object nine times in ten, scaled by 0.5 to 3."""
    frame, boxes = frames.image(i), frames.boxes[i]
    zoom = max(log_uniform(rng, 0.5, 3.0), 1.02 * side / HEIGHT)
    if len(boxes):  # no object may outgrow the square
        zoom = min(zoom, max(0.9 * side / (boxes[:, 3:] - boxes[:, 1:3]).max(), 1.02 * side / HEIGHT))
    if rng.random() < 0.5 and side < HEIGHT:
        zoom = min(zoom, 1.0) if len(boxes) and (boxes[:, 3:] - boxes[:, 1:3]).max() > 0.9 * side else 1.0
    window = min(side / zoom, HEIGHT)
    low, high = np.zeros(2), np.array([WIDTH, HEIGHT]) - window
    if len(boxes) and rng.random() < 0.9:
        box = boxes[rng.integers(len(boxes))]
        centre = 0.5 * (box[1:3] + box[3:5])
        low, high = np.clip(centre - 0.9 * window, 0, high), np.clip(centre - 0.1 * window, 0, high)
    corner = np.floor(rng.uniform(low, high + 1e-6))
    cut = round(window)
    x, y = corner.astype(int)
    crop = frame[y:y + cut, x:x + cut]
    scale = side / np.array(crop.shape[1::-1], float)
    image = cv2.resize(crop, (side, side), interpolation=cv2.INTER_AREA if zoom < 1 else cv2.INTER_LINEAR)
    placed = boxes.copy()
    placed[:, 1:] = (boxes[:, 1:] - np.tile([x, y], 2)) * np.tile(scale, 2)
    return image, clip_boxes(placed, side)


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def clip_boxes(boxes: NDArray, side: int, least: float = 0.45) -> NDArray[np.float32]:
    """Boxes cut at the square's edge; those of which less than `least` is left go."""
    cut = boxes.copy()
    cut[:, 1:] = np.clip(boxes[:, 1:], 0, side)
    area = np.prod(boxes[:, 3:] - boxes[:, 1:3], axis=1)
    left = np.prod(cut[:, 3:] - cut[:, 1:3], axis=1)
    return cut[left >= least * np.maximum(area, 1e-6)].astype(np.float32)


def painted_background(rng: Rng, side: int) -> NDArray[np.uint8]:
    """A sky of two colours with clouds, often with ground, woods or blocks below: nothing real, much variety."""
    height = np.linspace(0.0, 1.0, side)[:, None, None]
    blue = np.array([rng.uniform(120, 255), rng.uniform(90, 230), rng.uniform(50, 220)])
    image = np.ones((side, side, 1)) * (blue * (1 - height) + (blue + rng.uniform(-60, 60, 3)) * height)
    image += rng.uniform(0, 60) * (noise(rng, side, rng.uniform(1.0, 2.0)) - 0.4)[..., None]
    if rng.random() < 0.65:
        for _ in range(rng.integers(1, 4)):  # layers of land, nearer ones below
            horizon = rng.uniform(0.1, 1.0) + rng.uniform(0, 0.25) * (noise(rng, side, rng.uniform(0.6, 1.8))[0] - 0.5)
            land = height[..., 0] > horizon[None]
            texture = noise(rng, side, rng.uniform(0.2, 1.2))[..., None] * rng.uniform(20, 140)
            image = np.where(land[..., None], rng.uniform(10, 170, 3) - 40 + texture, image)
    for _ in range(rng.integers(0, 5) if rng.random() < 0.5 else 0):  # trunks, poles, houses
        x, y = rng.integers(0, side, 2)
        w, h = int(log_uniform(rng, 2, side / 3)), int(log_uniform(rng, 4, side))
        cv2.rectangle(image, (int(x), int(y)), (int(x) + w, int(y) + h), tuple(rng.uniform(0, 255, 3)), -1)
    return np.clip(image, 0, 255).astype(np.uint8)


def noise(rng: Rng, side: int, smoothness: float) -> NDArray[np.float32]:
    """Fractal noise (side, side) in 0-1: random grids of doubling fineness, amplitude falling with it."""
    total, weight = np.zeros((side, side), np.float32), 0.0
    for octave in range(1, 8):
        cells, amplitude = 2**octave, 2.0 ** (-smoothness * octave)
        grid = rng.random((cells + 1, cells + 1), np.float32)
        total += amplitude * cv2.resize(grid, (side, side), interpolation=cv2.INTER_CUBIC)
        weight += amplitude
    return np.clip(total / weight, 0, 1)


def fog(image: NDArray, transmission: float, veil: NDArray) -> NDArray[np.uint8]:
    """Beer-Lambert: what is left of the picture plus the light scattered on the way."""
    table = np.clip(np.arange(256)[:, None] * transmission + (1.0 - transmission) * veil, 0, 255)
    return cv2.LUT(np.clip(image, 0, 255).astype(np.uint8), table.astype(np.uint8)[None])


def paste(rng: Rng, image: NDArray, boxes: NDArray, sprites: list[NDArray], size: float, transmission: float, veil: NDArray,
          label: int | None) -> NDArray[np.float32]:
    """Blend a sprite of `size` pixels into the picture in place; returns the boxes with its own, without those it hides.

    A drone too faint for anybody to see is left out: it is neither there nor not there.
    """
    side = image.shape[0]
    sprite = sprites[rng.integers(len(sprites))]
    scale = size / max(sprite.shape[:2])
    small = cv2.resize(sprite, (max(round(sprite.shape[1] * scale), 2), max(round(sprite.shape[0] * scale), 2)),
                       interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    small = small[:, ::-1] if rng.random() < 0.5 else small
    if rng.random() < 0.4:
        small = tilt(small, rng.uniform(-35, 35))
    h, w = small.shape[:2]
    if h >= side or w >= side:
        return boxes
    x, y = int(rng.integers(0, side - w)), int(rng.integers(0, side - h))
    alpha = small[..., 3:].astype(np.float32) / 255.0
    if size > 12 and rng.random() < 0.5:
        alpha = cv2.GaussianBlur(alpha, (0, 0), 0.6)[..., None]
    light = rng.uniform(0.5, 1.2)
    shade = fog(np.clip(small[..., :3] * light, 0, 255), transmission, veil).astype(np.float32)
    under = image[y:y + h, x:x + w].astype(np.float32)
    blended = alpha * shade + (1 - alpha) * under
    change = np.abs(blended - under).mean(axis=2)
    if label is not None and np.percentile(change, 90) < 7.0:
        return boxes
    image[y:y + h, x:x + w] = blended.astype(np.uint8)
    box = np.array([x, y, x + w, y + h], np.float32)
    if len(boxes):
        shared = np.clip(np.minimum(boxes[:, 3:], box[2:]) - np.maximum(boxes[:, 1:3], box[:2]), 0, None).prod(1)
        boxes = boxes[shared < 0.4 * np.prod(boxes[:, 3:] - boxes[:, 1:3], axis=1)]
    if label is None:
        return boxes
    return np.concatenate([boxes, np.append(label, box)[None]]).astype(np.float32)


def visible(image: NDArray[np.uint8], box: NDArray) -> bool:
    """Whether anything stands out in a box."""
    x1, y1, x2, y2 = np.rint(box).astype(int)
    part = image[y1:y2, x1:x2]
    return part.size > 0 and float(np.ptp(np.percentile(part, [1, 99]))) > 6.0


def tilt(sprite: NDArray[np.uint8], degrees: float) -> NDArray[np.uint8]:
    """A sprite turned in the picture and cut to its outline again."""
    h, w = sprite.shape[:2]
    turn = cv2.getRotationMatrix2D((w / 2, h / 2), degrees, 1.0)
    wide = int(np.hypot(h, w)) + 2
    turn[:, 2] += 0.5 * wide - np.array([w, h]) / 2
    turned = cv2.warpAffine(sprite, turn, (wide, wide))
    rows, columns = np.flatnonzero((turned[..., 3] > 50).any(1)), np.flatnonzero((turned[..., 3] > 50).any(0))
    if rows.size < 2 or columns.size < 2:
        return sprite
    return turned[rows[0]:rows[-1] + 1, columns[0]:columns[-1] + 1]


def finish(rng: Rng, image: NDArray[np.uint8], boxes: NDArray[np.float32]) -> Sample:
    """What happens between the scene and the file: mirror, light, colour, blur, noise, JPEG."""
    side = image.shape[0]
    if rng.random() < 0.5:
        image = image[:, ::-1]
        boxes = boxes[:, [0, 3, 2, 1, 4]] * [1, -1, 1, -1, 1] + np.array([0, side, 0, side, 0])
    if rng.random() < 0.6:
        gain, gamma, tint = rng.uniform(0.65, 1.2), np.exp(rng.normal(0, 0.25)), rng.uniform(0.93, 1.07, 3)
        table = np.clip(255 * gain * tint * (np.arange(256)[:, None] / 255.0) ** gamma + rng.uniform(-15, 15), 0, 255)
        image = cv2.LUT(image, table.astype(np.uint8)[None])
    if rng.random() < 0.06:
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
