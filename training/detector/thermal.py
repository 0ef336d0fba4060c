"""Thermal training: the infrared clips, their split, and training crops of them.

The data are the infrared part of F. Svanstrom's Drone-detection-dataset (CC0 1.0): 245 clips of 320 x 256 pixels, white-hot,
at most one box a frame. Frames without a box may show what nobody labelled; they are not trained on.
"""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from album import Sample, cut
from clips import CLASSES, INFRARED_SIZE, read_boxes, scaled, split_of
from numpy.typing import NDArray
from painted import Rng, log_uniform, noise
from samples import visible
from simulated import build_thermal

WIDTH, HEIGHT = INFRARED_SIZE
INPUT = 640  # pixels of the longer side at which the network sees an image: twice those of the clips
STRIDE = 6   # frames of a clip between two that are cached
BATCHES = ((128, 28, 0.35), (192, 12, 0.35), (256, 7, 0.2), (448, 2, 0.1))
SIMULATED = 0.2  # of the windows are of the simulator
SHARES = {'drone': 0.34, 'bird': 0.22, 'airplane': 0.26, 'helicopter': 0.18}  # of the other windows
OTHERS = 36.0  # pixels as the network sees them, label included, from which on other things than drones are pasted
MARGIN = 3   # pixels around a label that are cut out with it
PLAIN, FAINT = 7.0, 12.0  # of 255: deviation of a sky from a plane, least contrast of what is pasted


class Cutout(NamedTuple):
    """What an object (h, w) adds to the sky around it in grey levels, and its label's box (4,) inside."""

    glow: NDArray[np.float32]
    box: NDArray[np.float32]


class ThermalFrames:
    """Every sixth frame of the infrared clips as a memory map (n, 256, 320), their clips and boxes (k, 5).

    Or images of the simulator: those of eight in nine worlds are `simulated`, the others `simulated_validation`.

    Parameters:
        data: the data set.
        cache: folder of the decoded frames.
        split: the clips, or which images of the simulator.
        scenes: whether some places are left out of all splits but `test_scene`.
    """

    def __init__(self, data: Path, cache: Path, split: str, scenes: bool = False) -> None:
        name = 'thermal_simulated' if split.startswith('simulated') else 'thermal'
        store, index = cache / f'{name}.npy', cache / f'{name}.json'
        if not index.exists():
            store.parent.mkdir(parents=True, exist_ok=True)
            build(data, store, index) if name == 'thermal' else build_thermal(store, index)
        entries = json.loads(index.read_text())
        self.rows = [i for i, entry in enumerate(entries) if infrared_split(entry['clip'], scenes) == split]
        self.images = np.load(store, mmap_mode='r')
        self.clips = [entries[i]['clip'] for i in self.rows]
        self.boxes = [np.array(entries[i]['boxes'], np.float32).reshape(-1, 5) for i in self.rows]

    def image(self, i: int) -> NDArray[np.uint8]:
        """The i-th frame (256, 320) as a read-only view."""
        return self.images[self.rows[i]]


def infrared_split(clip: str, scenes: bool) -> str:
    """The split of an infrared clip, or of a simulated world such as IR_SIM_007."""
    if '_SIM_' in clip:
        return 'simulated_validation' if int(clip[-3:]) % 9 == 8 else 'simulated'
    return split_of(clip, scenes)


def build(data: Path, store: Path, index: Path) -> None:
    """Decode every sixth frame of every infrared clip of `data` once."""
    frames, entries = [], []
    for label_file in sorted((data / 'labels_ir').glob('*.csv')):
        boxes, number = read_boxes(label_file), 0
        video = cv2.VideoCapture(str(data / 'video_ir' / f'{label_file.stem}.mp4'))
        while video.grab():
            if number % STRIDE == 0:
                frames.append(cv2.cvtColor(video.retrieve()[1], cv2.COLOR_BGR2GRAY))
                entries.append({'clip': label_file.stem, 'frame': number, 'boxes': boxes.get(number, [])})
            number += 1
    np.save(store, np.stack(frames))
    index.write_text(json.dumps(entries))


class ThermalSampler:
    """Makes labelled crops; the same generator makes the same crop. Labels are (k, 5): class, x1, y1, x2, y2 in pixels.

    Objects are pasted before what other clips show, too, so that it is not the place that tells a drone from a bird.

    Parameters:
        frames: the frames that may be trained on.
        simulated: images of the simulator.
    """

    def __init__(self, frames: ThermalFrames, simulated: ThermalFrames) -> None:
        self._frames, self._simulated = frames, simulated
        by_clip: dict[str, dict[str, list[int]]] = {kind: defaultdict(list) for kind in SHARES}
        for i, (clip, boxes) in enumerate(zip(frames.clips, frames.boxes, strict=True)):
            if len(boxes):
                by_clip[clip.split('_')[1].lower()][clip].append(i)
        self._by_kind = {kind: list(clips.values()) for kind, clips in by_clip.items()}
        self._cutouts: list[list[list[Cutout]]] = []  # by class and clip
        for kind in CLASSES:
            clips = [[cutout(frames.image(i), frames.boxes[i][0, 1:]) for i in rows[::5]] for rows in self._by_kind[kind]]
            self._cutouts.append([some for clip in clips if (some := [one for one in clip if one])])

    def draw(self, rng: Rng, side: int) -> Sample:
        """One crop of side x side, half the large ones mosaics of four."""
        if side < 192 or rng.random() < 0.5:
            image, boxes = self._view(rng, side)
        else:
            half = side // 2
            views = [self._view(rng, half) for _ in range(4)]
            image = np.vstack([np.hstack([views[k][0], views[k + 1][0]]) for k in (0, 2)])
            moves = [np.array([0, x, y, x, y], np.float32) for y in (0, half) for x in (0, half)]
            boxes = np.concatenate([there + move for (_, there), move in zip(views, moves, strict=True)])
        return finish(rng, image, boxes)

    def _view(self, rng: Rng, side: int) -> Sample:
        """A window of a frame around an object, or anywhere, with objects of other clips pasted in."""
        frame, boxes = self._any(rng)
        least = side / HEIGHT
        zoom = max(log_uniform(rng, 1.2, 3.5) if rng.random() < 0.7 else 2.0, least)
        if len(boxes):
            zoom = max(min(zoom, 0.9 * side / float((boxes[:, 3:] - boxes[:, 1:3]).max())), least)
        window = side / zoom
        corner = np.array([rng.uniform(0, WIDTH - window), rng.uniform(0, HEIGHT - window)])
        if len(boxes) and rng.random() < 0.65:
            box = boxes[rng.integers(len(boxes))]
            centre = 0.5 * (box[1:3] + box[3:])
            corner = np.clip(centre - window * rng.uniform(0.1, 0.9, 2), 0, [WIDTH - window, HEIGHT - window])
        move = np.array([[zoom, 0, -zoom * corner[0]], [0, zoom, -zoom * corner[1]]])
        image = cv2.warpAffine(frame, move, (side, side), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        boxes = cut(scaled(boxes - np.array([0, *corner, *corner], np.float32), zoom), side, side)
        for _ in range(rng.choice(3, p=[0.4, 0.4, 0.2])):
            label = int(rng.choice(4, p=[0.5, 0.18, 0.2, 0.12]))
            image, boxes = self._paste(rng, image, boxes, label, zoom)
        return image, boxes

    def _any(self, rng: Rng) -> Sample:
        """A frame of a clip with its object, or an image of the simulator."""
        if rng.random() < SIMULATED:
            i = int(rng.integers(len(self._simulated.rows)))
            return self._simulated.image(i), self._simulated.boxes[i]
        kind = str(rng.choice(list(SHARES), p=list(SHARES.values())))
        clips = self._by_kind[kind]
        rows = clips[rng.integers(len(clips))]
        i = int(rows[rng.integers(len(rows))])
        return self._frames.image(i), self._frames.boxes[i]

    def _paste(self, rng: Rng, image: NDArray[np.uint8], boxes: NDArray, label: int, zoom: float) -> Sample:
        """Add an object of another clip somewhere, larger or smaller, brighter or fainter; nothing where it would not show."""
        clips = self._cutouts[label]
        one = (clip := clips[rng.integers(len(clips))])[rng.integers(len(clip))]
        scale = zoom * log_uniform(rng, 0.7, 1.8)
        h, w = (max(round(side * scale), 4) for side in one.glow.shape)
        if h >= image.shape[0] or w >= image.shape[1]:
            return image, boxes
        glow = cv2.resize(one.glow, (w, h), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
        glow = glow * rng.uniform(0.5, 1.3)
        if label and max(h, w) - 2 * MARGIN * scale < OTHERS:  # nothing tells the smaller apart but where they are
            return image, boxes
        box = one.box * np.tile([w / one.glow.shape[1], h / one.glow.shape[0]], 2)
        if rng.random() < 0.5:
            glow, box = glow[:, ::-1], np.array([w - box[2], box[1], w - box[0], box[3]])
        x, y = int(rng.integers(image.shape[1] - w)), int(rng.integers(image.shape[0] - h))
        taken = np.minimum(boxes[:, 3:], [x + w, y + h]) > np.maximum(boxes[:, 1:3], [x, y])
        under = image[y:y + h, x:x + w].astype(np.float32)
        over = np.clip(under + glow, 0, 255)
        if taken.all(axis=1).any() or np.percentile(np.abs(over - under), 96) < FAINT + 1.5 * np.abs(np.diff(under)).mean():
            return image, boxes
        image = image.copy()
        image[y:y + h, x:x + w] = over
        return image, np.concatenate([boxes, [[label, *(box + np.tile([x, y], 2))]]]).astype(np.float32)


def cutout(image: NDArray[np.uint8], box: NDArray[np.float32]) -> Cutout | None:
    """What an object adds to the plane of grey around its box; None where there is no plain sky, or nothing to be seen."""
    x1, y1 = np.maximum(np.floor(box[:2]).astype(int) - MARGIN, 0)
    x2, y2 = np.minimum(np.ceil(box[2:]).astype(int) + MARGIN, [WIDTH, HEIGHT])
    part = image[y1:y2, x1:x2].astype(np.float32)
    rim = np.ones(part.shape, bool)
    rim[2:-2, 2:-2] = False
    rows, columns = np.mgrid[:part.shape[0], :part.shape[1]] / 32.0
    plane = np.stack([np.ones_like(rows), rows, columns], -1)
    sky, *_ = np.linalg.lstsq(plane[rim], part[rim], rcond=None)
    off = part - plane @ sky
    if off[rim].std() > PLAIN or off.max() < FAINT + 3.0 * off[rim].std():
        return None
    # The sky's own noise is left behind, and nothing is added at the edge.
    edge = np.minimum.reduce([*np.meshgrid(*(np.minimum(np.arange(n), np.arange(n)[::-1]) for n in part.shape[::-1]))])
    glow = off * np.clip(np.abs(off) / (3.0 * off[rim].std() + 1.0) - 0.3, 0, 1) * np.clip(edge / 2.0, 0, 1)
    return Cutout(glow.astype(np.float32), (box - [x1, y1, x1, y1]).astype(np.float32))


def finish(rng: Rng, image: NDArray[np.uint8], boxes: NDArray[np.float32]) -> Sample:
    """From the scene to the file: mirror, gain, polarity, sensor noise, focus, compression; three equal channels."""
    side = image.shape[0]
    if rng.random() < 0.5:
        image, boxes = image[:, ::-1], boxes[:, [0, 3, 2, 1, 4]] * [1, -1, 1, -1, 1] + np.array([0, side, 0, side, 0])
    grey = image.astype(np.float32)
    if rng.random() < 0.15:
        grey += rng.uniform(5, 40) * (noise(rng, side, rng.uniform(1.0, 2.0)) - 0.5)  # haze and clouds
    if rng.random() < 0.2:
        grey = cv2.GaussianBlur(grey, (0, 0), rng.uniform(0.5, 1.6))
    if rng.random() < 0.7:  # another gain: an automatic one follows whatever is in view
        gamma, gain, middle = np.exp(rng.normal(0, 0.25)), np.exp(rng.normal(-0.1, 0.35)), rng.uniform(40, 200)
        grey = 255.0 * (np.clip(grey, 0, 255) / 255.0) ** gamma
        grey = (grey - grey.mean()) * gain + (middle if rng.random() < 0.5 else grey.mean())
    if rng.random() < 0.35:
        cells = (max(int(side / rng.uniform(1.0, 2.5)), 2),) * 2  # noise is of pixels of the sensor, which are enlarged
        grain = rng.normal(0, rng.uniform(1, 14), cells).astype(np.float32)
        if rng.random() < 0.6:  # left over from the flat field: columns and rows of their own
            grain += rng.normal(0, rng.uniform(0.5, 5), (1, cells[1])) + rng.normal(0, rng.uniform(0.5, 4), (cells[0], 1))
        grey += cv2.resize(grain.astype(np.float32), (side, side), interpolation=cv2.INTER_LINEAR)
    if rng.random() < 0.35:
        grey = 255.0 - grey  # black-hot
    out = np.clip(grey, 0, 255).astype(np.uint8)
    if rng.random() < 0.25:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(40, 95))]
        out = cv2.imdecode(cv2.imencode('.jpg', out, quality)[1], cv2.IMREAD_GRAYSCALE)
    boxes = boxes[[visible(out, box[1:]) for box in boxes]] if len(boxes) else boxes
    return np.repeat(out[..., None], 3, axis=2), boxes.astype(np.float32)
