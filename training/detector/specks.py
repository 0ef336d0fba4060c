"""Specks of 5 to 7 pixels on real and painted backgrounds: how often a detector reports those that rest, drift, or fly.

`python specks.py MODEL.onnx [...] --data DRONE_DETECTION [--thermal]`; models of one network that differ in their metadata
share its candidates. Paths of drones are labelled ones of clips that nobody trained on.
"""

from __future__ import annotations

import argparse
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from clips import INFRARED_SIZE, RATE, STRIDE, WIDTH, clips_of, film, folder_of, read_boxes
from numpy.typing import NDArray
from painted import Rng, noise

from av_vision import Detector, DetectorSettings, TemporalDetector
from av_vision.detections import Candidates

KINDS = ('at rest', 'drifting', 'hot pixel', 'flying')
IMAGES, SETTLED = 25, 12  # of a sequence, every 0.1 s, and after how many a decision is due
NEAR = 8.0  # pixels from the speck, within which a box is its
Look = tuple[Candidates, float, NDArray[np.float64]]  # candidates, time, place


def backgrounds(rng: Rng, data: Path, kind: str, count: int) -> list[list[NDArray[np.uint8]]]:
    """Sequences of images: of clips of airplanes that were not trained on, and of painted clouds.

    Parameters:
        rng: random numbers.
        data: the data set.
        kind: visible (V) or infrared (IR).
        count: sequences of either sort.
    """
    clips = [clip for clip in clips_of(data, 'test_clip', kind) if 'AIRPLANE' in clip][:count]
    real = [[image for _, image, _ in islice(film(data, clip), IMAGES)] for clip in clips]
    width, height = INFRARED_SIZE if kind == 'IR' else (WIDTH, WIDTH * 4 // 5)
    clouds = [np.clip(90 + 70 * noise(rng, width, 2.0), 0, 255).astype(np.uint8)[:height] for _ in range(count)]
    return real + [[cv2.cvtColor(cloud, cv2.COLOR_GRAY2BGR)] * IMAGES for cloud in clouds]


def flights(data: Path, kind: str) -> list[NDArray[np.float64]]:
    """Paths (IMAGES, 2) in pixels of labelled drones of less than 8 pixels without the labels' padding."""
    padding, found = np.array([20.0, 18.0] if kind == 'V' else [10.0, 9.0]), []
    for split in ('validation', 'test_clip', 'test_scene'):
        for clip in clips_of(data, split, kind):
            boxes = read_boxes(data / folder_of(clip, 'labels') / f'{clip}.csv')
            for first in range(0, max(boxes, default=0) - STRIDE * IMAGES, 2 * STRIDE * IMAGES):
                rows = [boxes.get(first + STRIDE * k, []) for k in range(IMAGES)]
                if 'DRONE' in clip and all(len(row) == 1 for row in rows):
                    box = np.array([row[0][1:] for row in rows])
                    if np.median((box[:, 2:] - box[:, :2] - padding).max(axis=1)) < 8.0:
                        found.append(0.5 * (box[:, :2] + box[:, 2:]))
    return found


def place_of(rng: Rng, kind: str, shape: tuple[int, ...], paths: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Places (IMAGES, 2) of a speck: still, in even drift of 1 to 8 pixels/s, or on one of the `paths`."""
    times = np.arange(IMAGES)[:, None] * STRIDE / RATE
    angle, start = rng.uniform(0, 2 * np.pi), np.array([shape[1], 0.6 * shape[0]]) * rng.uniform(0.2, 0.8, 2)
    if kind == 'drifting':
        return start + times * rng.uniform(1.0, 8.0) * np.array([np.cos(angle), np.sin(angle)])
    if kind == 'flying':
        return np.asarray(paths[rng.integers(len(paths))])
    return np.round(start) + 0.0 * times


def drawn(rng: Rng, image: NDArray[np.uint8], place: NDArray, sigma: float, height: float) -> NDArray[np.uint8]:
    """The image with a spot; a `sigma` (pixels) of 0 is a pixel, `height` is in grey levels."""
    rows, columns = np.ogrid[:image.shape[0], :image.shape[1]]
    apart = (columns - place[0]) ** 2 + (rows - place[1]) ** 2
    spot = np.exp(-0.5 * apart / sigma**2) if sigma else (apart < 0.5).astype(float)
    grain = rng.normal(0.0, 1.5, image.shape[:2])
    return np.clip(image + (height * spot + grain)[..., None], 0, 255).astype(np.uint8)


def looks(detector: Detector, rng: Rng, data: Path, camera: str, kind: str, count: int) -> list[list[Look]]:
    """What a detector sees of specks of a kind, by sequence.

    Parameters:
        detector: the detector.
        rng: random numbers.
        data: the data set.
        camera: visible (V) or infrared (IR).
        kind: one of `KINDS`.
        count: sequences of real, and of painted, backgrounds.
    """
    found, paths = [], flights(data, camera)
    for images in backgrounds(rng, data, camera, count):
        places = place_of(rng, kind, images[0].shape, paths)
        sigma = 0.0 if kind == 'hot pixel' else rng.uniform(5.0, 7.0) / 4.0
        height = rng.uniform(70.0, 160.0) * (1 if camera == 'IR' or rng.random() < 0.3 else -1)
        temporal = TemporalDetector(detector)
        found.append([(temporal.look(drawn(rng, image, place, sigma, height), k * STRIDE / RATE)[0], k * STRIDE / RATE, place)
                      for k, (image, place) in enumerate(zip(images, places, strict=False))])
    return found


def reported(detector: Detector, sequences: list[list[Look]]) -> tuple[float, float]:
    """Shares of the images in which specks are reported, in the first second and then."""
    rows = []
    for sequence in sequences:
        temporal = TemporalDetector(detector)
        found = [temporal.fuse(seen, time)[0].centres - place for seen, time, place in sequence]
        rows.append([bool((np.linalg.norm(away, axis=1) < NEAR).any()) for away in found])
    return tuple(float(np.mean([row[part] for row in rows])) for part in (slice(SETTLED), slice(SETTLED, None)))  # type: ignore[return-value]


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('models', type=Path, nargs='+')
    parser.add_argument('--data', type=Path, required=True, help='the drone_detection data set')
    parser.add_argument('--thermal', action='store_true')
    parser.add_argument('--count', type=int, default=4, help='sequences of real, and of painted, backgrounds, of each kind')
    args = parser.parse_args()
    detectors = [Detector(model, DetectorSettings(keep=('drone',), threads=1)) for model in args.models]
    print(f'{args.count} + {args.count} sequences: share of the images with a report, in the first 1.2 s / then')
    camera = 'IR' if args.thermal else 'V'
    for number, kind in enumerate(KINDS):
        sequences = looks(detectors[0], np.random.default_rng(number), args.data, camera, kind, args.count)
        shares = [' / '.join(f'{share:.2f}' for share in reported(detector, sequences)) for detector in detectors]
        print(f'{kind:10} ' + '   '.join(shares), flush=True)


if __name__ == '__main__':
    main()
