"""The real recordings: clips, their scenes, the split, and a cache of decoded frames.

The data set is F. Svanstrom's Drone-detection-dataset (CC0 1.0), of which this module caches the visible part: 170 clips of
640 x 512 pixels (V_DRONE_001 ...), one CSV of boxes a clip. `thermal.py` has the infrared part (IR_DRONE_001 ...). Many drone
clips show one place on one day; a split by clip alone is therefore optimistic, and two places are held out whole.
"""

from __future__ import annotations

import csv
import json
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from tight import tightened

WIDTH, HEIGHT = 640, 512
INFRARED_SIZE = (320, 256)  # width, height
CLASSES = ('drone', 'bird', 'airplane', 'helicopter')
# Places and days that no training clip shows (drones over the ploughed field with poplars and over the dark wood;
# the birds in the red tree; airplanes at the fence; the late helicopter clips).
UNSEEN_SCENES = {'drone': (*range(43, 55),), 'bird': (20, 22, 23, 10, 14), 'airplane': (49, 50, 44, 22),
                 'helicopter': (49, 52, 55, 58, 61)}
RATE, STRIDE = 30.0, 3  # frames/s; a rig processes about ten of them
SPLITS = ('train', 'validation', 'test_clip', 'test_scene')
# Of the infrared clips, numbers that show places of their own; they are `test_scene` while a training leaves them out.
INFRARED_SCENES = {'drone': range(139, 158), 'bird': range(14, 26), 'airplane': range(26, 35), 'helicopter': range(31, 44)}


def split_of(clip: str, scenes: bool = True) -> str:
    """The split of a clip such as V_DRONE_043; `validation` serves threshold, calibration and checkpoint.

    Infrared clips have a `test_scene` with `scenes` alone: there are too few places to leave them out of what ships.
    """
    kind, label, number = clip.split('_')
    unseen = (UNSEEN_SCENES if kind == 'V' else INFRARED_SCENES)[label.lower()]
    if int(number) in unseen and (scenes or kind == 'V'):
        return 'test_scene'
    place = (int(number) * 7919) % 20
    return 'test_clip' if place < 3 else 'validation' if place < (6 if kind == 'V' else 5) else 'train'


def folder_of(clip: str, content: str) -> str:
    """The folder of a clip's `video` or `labels` in the data set."""
    return f'{content}_ir' if clip.startswith('IR') else content


def read_boxes(path: Path) -> dict[int, list[tuple[int, float, float, float, float]]]:
    """Boxes of a label file: frame -> [(class index, x1, y1, x2, y2)] in pixels."""
    boxes = defaultdict(list)
    with path.open() as file:
        for row in csv.DictReader(file):
            x, y, w, h = (float(row[key]) for key in ('x', 'y', 'width', 'height'))
            boxes[int(row['frame'])].append((CLASSES.index(row['label'].lower()), x, y, x + w, y + h))
    return boxes


def clips_of(data: Path, split: str, kind: str = 'V') -> list[str]:
    """Names of the clips of a split, visible (V) or infrared (IR, without a split by scene)."""
    labels = sorted((data / folder_of(kind, 'labels')).glob('*.csv'))
    return [path.stem for path in labels if split_of(path.stem, scenes=False) == split]


def film(data: Path, clip: str) -> Iterator[tuple[float, NDArray[np.uint8], NDArray[np.float32]]]:
    """Every third frame of a clip as a rig would see them: time in s, image, labels (k, 5) of class, x1, y1, x2, y2."""
    boxes = read_boxes(data / folder_of(clip, 'labels') / f'{clip}.csv')
    video, number = cv2.VideoCapture(str(data / folder_of(clip, 'video') / f'{clip}.mp4')), 0
    while video.grab():
        if number % STRIDE == 0:
            yield number / RATE, video.retrieve()[1], np.array(boxes.get(number, []), np.float32).reshape(-1, 5)
        number += 1


def build_cache(data: Path, cache: Path, stride: int = 8) -> None:
    """Decode every stride-th frame of every clip once into `frames.u8` (n, 512, 640, 3) and tight boxes into `index.json`."""
    if (cache / 'index.json').exists():
        return
    cache.mkdir(parents=True, exist_ok=True)
    print(f'decoding the clips of {data} into {cache} (7 GB)', flush=True)
    index = []
    with (cache / 'frames.u8').open('wb') as out:
        for label_file in sorted((data / 'labels').glob('*.csv')):
            clip, boxes = label_file.stem, read_boxes(label_file)
            video = cv2.VideoCapture(str(data / 'video' / f'{clip}.mp4'))
            number = 0
            while video.grab():
                if number % stride == 0:
                    frame = video.retrieve()[1]
                    if frame.shape[:2] != (HEIGHT, WIDTH):
                        raise ValueError(f'{clip} has frames of {frame.shape[1::-1]}, expected {(WIDTH, HEIGHT)}')
                    out.write(frame.tobytes())
                    labels = np.array(boxes.get(number, []), np.float32).reshape(-1, 5)
                    there = tightened(frame, labels).tolist()
                    index.append({'clip': clip, 'frame': number, 'split': split_of(clip), 'boxes': there})
                number += 1
    (cache / 'index.json').write_text(json.dumps(index))


def scaled(boxes: NDArray, factor: float) -> NDArray[np.float32]:
    """Boxes (k, 5) of a image scaled by a factor."""
    return (boxes * np.array([1.0, factor, factor, factor, factor])).astype(np.float32)


class Frames:
    """The cached frames of some splits: images (n, 512, 640, 3) as a memory map, tight boxes (k, 5) of class and corners."""

    def __init__(self, cache: Path, *splits: str) -> None:
        index = json.loads((cache / 'index.json').read_text())
        self.images = np.memmap(cache / 'frames.u8', np.uint8, 'r', shape=(len(index), HEIGHT, WIDTH, 3))
        self.rows = [i for i, entry in enumerate(index) if entry['split'] in splits]
        self.clips = [index[i]['clip'] for i in self.rows]
        self.boxes = [np.array(index[i]['boxes'], np.float32).reshape(-1, 5) for i in self.rows]

    def __len__(self) -> int:
        return len(self.rows)

    def image(self, i: int) -> NDArray[np.uint8]:
        """The i-th frame as a read-only view."""
        return self.images[self.rows[i]]
