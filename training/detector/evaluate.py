"""Measure a detector: `python evaluate.py MODEL.onnx --cache FOLDER --data DRONE_DETECTION` prints the model card's tables.

With `--classes airplane,bird,kite` a COCO model is measured on the same frames.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from clips import HEIGHT, NO_PADDING, WIDTH, Frames, build_cache, clips_of, film, scaled
from material import CROWD
from measure import detect_all, extent, match, measure
from numpy.typing import NDArray
from pasting import crowd, paste
from simulated import boxes_of
from sprites import build_bank

from av_common.camera import PinholeCamera
from av_common.frames import FLU_TO_OPTICAL, rotation_from_rpy
from av_simulator.rendering.atmosphere import Atmosphere
from av_simulator.rendering.scene_renderer import SceneRenderer
from av_simulator.rendering.scenes import SCENES
from av_simulator.rendering.view import FIRST_TARGET_ID, Drone, RenderedImage, View
from av_vision.bearing import bearings_of_boxes
from av_vision.yolo import Detector, DetectorSettings

BANDS = ((5, 8), (8, 12), (12, 20), (20, 40), (40, 80), (80, 160), (160, 300))
SLICE = 416  # pixels; they are enlarged threefold, to the model's input
LOWEST = 0.02


def real(detector: Detector, threshold: float, data: Path, clips: bool) -> None:
    """The held-out clips, by split: every third frame in order, each by itself and with time."""
    print('split      results         frames drones  F1@.3  F1@.5  P@.3   R@.3   AP@.3  AP@.5  <5 px  false  ECE')
    for split in ('validation', 'test_clip', 'test_scene'):
        results = detect_all(detector, data, split)
        clip, sizes = np.array([result.clip for result in results]), sizes_of_drones(data, split)
        for fused in (False, True):
            m = measure(results, detector, fused)
            figures = (m.f1(threshold), m.f1(threshold, 0.5), m.precision(threshold), m.recall(threshold),
                       m.average_precision(0.3), m.average_precision(0.5), m.centred(threshold), m.false_frames(threshold),
                       m.calibration_error())
            print(f'{split:10} {"in time" if fused else "by themselves":13} {len(results):6} {m.drones.sum():6}  '
                  + '  '.join(f'{figure:.3f}' for figure in figures))
            wrong = np.unique(m.frames[(m.scores >= threshold) & ~m.hits])
            for kind in ('BIRD', 'AIRPLANE', 'HELICOPTER'):
                mine = np.array([kind in name for name in clip])
                print(f'           false drones on {kind.lower()} frames: {mine[wrong].sum()} of {mine.sum()}')
            right = np.unique(m.frames[(m.scores >= threshold) & m.hits])
            for low, high in BANDS:
                mine = (sizes >= low) & (sizes < high)
                if mine.any():
                    share = mine[right].sum() / mine.sum()
                    print(f'           drones of {low:3}-{high:3} px: found {share:.3f} of {mine.sum()}')
            for name in np.unique(clip) if clips and fused else ():
                mine = clip == name
                print(f'           {name:17} found in {mine[right].sum():3}, false in {mine[wrong].sum():3} of {mine.sum():3}')


def sizes_of_drones(data: Path, split: str) -> NDArray[np.float64]:
    """Size in pixels of the drone in each frame that `detect_all` takes; NaN where there is not just one."""
    found = []
    for clip in clips_of(data, split):
        for _, image, truth in film(data, clip):
            drones = truth[truth[:, 0] == 0, 1:]
            found.append(extent(image, drones[0]) if len(drones) == 1 else np.nan)
    return np.array(found)


def rendered(detect: Callable, frames: Frames, sprites: list[NDArray], width: int, count: int = 120) -> None:
    """Recall of drones of builds never trained on, pasted over frames of clips never trained on, by size and background."""
    for low, high in BANDS:
        found, near, behind = [], 0, []
        rng = np.random.default_rng([low, width])
        for _ in range(count):
            frame = frames.image(int(rng.integers(len(frames))))
            canvas = np.ascontiguousarray(np.tile(frame, (1, 2, 1))[:, :width] if width > WIDTH else frame[:, :HEIGHT])
            real_boxes = np.empty((0, 5), np.float32)
            while not len(real_boxes):
                size = np.exp(rng.uniform(np.log(low), np.log(high)))
                x = int(rng.integers(0, canvas.shape[1] - HEIGHT + 1))
                crop = canvas[:, x:x + HEIGHT].copy()
                real_boxes = paste(rng, crop, real_boxes, sprites, size, 1.0, np.zeros(3), 0)
            left, top, right, bottom = real_boxes[0, 1:].astype(int)
            behind.append(crowd(canvas, x + left, top, right - left, bottom - top))
            canvas[:, x:x + HEIGHT] = crop
            box = real_boxes[:, 1:] + np.array([x, 0, x, 0], np.float32)
            overlap, off = match(detect(canvas).boxes, box)
            good = overlap >= 0.3
            found.append(bool(good.any()))
            near += bool((off[good] <= max(5.0, 0.1 * size)).any())
        right, crowded = np.array(found), np.array(behind) > CROWD
        print(f'  {low:3}-{high:3} px: {right.mean():.3f}, centre within 5 px or a tenth of its size {near / count:.3f}; '
              f'before sky {right[~crowded].mean():.3f} of {np.sum(~crowded)}, '
              f'before other things {right[crowded].mean():.3f} of {np.sum(crowded)}')


Shot = tuple[RenderedImage, PinholeCamera, Drone, View]


def simulator_images(kind: str, fog: float, count: int, seed: int) -> list[Shot]:
    """A drone of 0.5 m at 3 to 20 m, anywhere in view of the rig's camera, in a scene of the simulator."""
    rng = np.random.default_rng(seed)
    camera = PinholeCamera(640, 480, 457.0, 457.0, 319.5, 239.5, (-0.08, 0.02, 0.0005, -0.0003, 0.0))
    renderer = SceneRenderer(camera, SCENES[kind](), [(0.5, 4)], seed)
    made = []
    for number in range(count):
        position = np.array([0.08, 0.0, 1.55])
        rotation = rotation_from_rpy(0.0, np.radians(-8.0), rng.uniform(-np.pi, np.pi)) @ FLU_TO_OPTICAL.T
        pixel = rng.uniform([30, 30], [610, 300])
        place = position + rng.uniform(3.0, 20.0) * (rotation @ camera.rays(pixel[None])[0])
        attitude = rotation_from_rpy(*rng.normal(0, 0.1, 2), rng.uniform(-np.pi, np.pi))
        drone = Drone(FIRST_TARGET_ID, place, attitude, 0.5, 4, rng.uniform(0, 6.28, 4))
        view = View(number, 0.1 * number, position, rotation, Atmosphere(fog), [drone])
        made.append((renderer.render(view), camera, drone, view))
    renderer.close()
    return made


def simulator(detector: Detector, threshold: float) -> None:
    """Recall in clear air, confidence against fog, error of bearings."""
    for kind in ('woodland', 'field', 'urban'):
        for fog in (0.0, 0.03, 0.06, 0.12, 0.25, 0.5):
            hits, visible, best, errors = 0, 0, [], []
            for image, camera, drone, view in simulator_images(kind, fog, 80, 5):
                boxes = boxes_of(image)
                if not len(boxes) and fog == 0.0:
                    continue
                visible += 1
                found = detector.detect(image.bgr)
                truth = np.pad(boxes if len(boxes) else np.zeros((1, 4), np.float32), ((0, 0), (1, 0)))
                overlap, _ = match(found.boxes, scaled(truth, 1.0, NO_PADDING)[:, 1:])
                good = np.flatnonzero(overlap >= 0.3)
                best.append(float(found.scores[good[0]]) if good.size else 0.0)
                if good.size and found.scores[good[0]] >= threshold:
                    hits += 1
                    seen = bearings_of_boxes(camera, found.centres[good[:1]], found.sizes[good[:1]], [1.0])
                    away = FLU_TO_OPTICAL.T @ view.to_optical(drone.position[None])[0]
                    errors.append(np.degrees(seen.azimuth[0] - np.arctan2(away[1], away[0])))
            rms = np.sqrt(np.mean(np.square(errors))) if errors else np.nan
            share = hits / max(visible, 1)
            print(f'  {kind:9} fog {fog:4.2f}/m: found {share:.3f} of {visible}, mean score {np.mean(best):.3f}, '
                  f'azimuth error {rms:.3f} deg RMSE')


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('model', type=Path)
    parser.add_argument('--cache', type=Path, required=True, help='folder for decoded frames (7 GB) and renders')
    parser.add_argument('--data', type=Path, required=True, help='the drone_detection data set')
    parser.add_argument('--classes', default='')
    parser.add_argument('--size', type=int, default=0)
    parser.add_argument('--clips', action='store_true', help='of each real clip, too')
    parser.add_argument('--only', choices=('real', 'rendered', 'simulator'))
    args = parser.parse_args()
    build_cache(args.data, args.cache)
    rename = dict.fromkeys(filter(None, args.classes.split(',')), 'drone')
    settings = {'keep': ('drone',), 'rename': rename, 'input_size': args.size}
    threshold = Detector(args.model, DetectorSettings(**settings)).threshold
    low = Detector(args.model, DetectorSettings(**settings, score_threshold=LOWEST))
    print(f'{args.model.name}, threshold {threshold}')
    if args.only in (None, 'real'):
        real(low, threshold, args.data, args.clips)
    if args.only in (None, 'rendered'):
        sprites, frames = build_bank(args.cache, 'test')['drone'], Frames(args.cache, 'test_clip', 'test_scene')
        print('rendered drones, recall at IoU 0.3, 512 x 512 images:')
        rendered(Detector(args.model, DetectorSettings(**settings)).detect, frames, sprites, HEIGHT)
        print(f'1280 x 512 images in tiles of {SLICE}:')
        rendered(Detector(args.model, DetectorSettings(**settings, slice_size=SLICE)).detect, frames, sprites, 1280, 60)
    if args.only in (None, 'simulator'):
        print('simulator, a drone of 0.5 m at 3 to 20 m:')
        simulator(low, threshold)


if __name__ == '__main__':
    main()
