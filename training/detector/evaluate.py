"""Measure a detector: `python evaluate.py MODEL.onnx --cache FOLDER --data DRONE_DETECTION` prints the model card's tables.

With `--coco MODEL` a COCO model, whose airplanes, birds and kites are drones, is measured on the same images beside it.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from clips import HEIGHT, WIDTH, Frames, build_cache
from elsewhere import SHARES, Elsewhere, look_at, together
from material import CROWD
from measure import detect_all, longer_sides, match, measure
from numpy.typing import NDArray
from pasting import crowd, paste
from places import JUDGED, SOURCES
from simulated import boxes_of
from sprites import build_bank
from tight import without_padding

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
COCO_CLASSES = ('airplane', 'bird', 'kite')  # what a drone is taken for
PARTS = ('real', 'elsewhere', 'rendered', 'simulator')
BEFORE_THINGS = {8: '0.75', 12: '0.85'}  # aims by the least size
Row = tuple[str, str, str]  # what, the aim, the figure


def real(detector: Detector, threshold: float, data: Path, clips: bool, regions: int) -> list[Row]:
    """The held-out clips, by split: every third frame in order, each by itself and with time, as a rig searches them."""
    aims = {'test_clip': ('known places', '0.93 / 0.80', '0.03'), 'test_scene': ('new places', '0.90 / 0.78', '0.08')}
    rows: list[Row] = []
    print('split      results       boxes    frames drones  F1@.3  F1@.5  P@.3   R@.3   AP@.3  AP@.5  <5 px  false  ECE')
    for split in ('validation', 'test_clip', 'test_scene'):
        results = detect_all(detector, data, split, regions)
        clip, sizes = np.array([result.clip for result in results]), longer_sides(results)
        for fused, loose in ((False, True), (False, False), (True, True), (True, False)):
            m = measure(results, detector, fused, loose)
            f1 = (m.f1(threshold), m.f1(threshold, 0.5))
            figures = (*f1, m.precision(threshold), m.recall(threshold), m.average_precision(0.3), m.average_precision(0.5),
                       m.centred(threshold), m.false_frames(threshold), m.calibration_error())
            kind = f'{"in time" if fused else "by themselves":13} {"labels" if loose else "tight":6}'
            row = '  '.join(f'{figure:.3f}' for figure in figures)
            print(f'{split:10} {kind} {len(results):8} {m.drones.sum():6}  {row}', flush=True)
            if fused and split in aims:
                name, aim, false = aims[split]
                boxes, most = ('boxes as labelled', '') if loose else ('tight boxes', aim)
                rows.append((f'clips of {name}, F1 at IoU 0.3 / 0.5, {boxes}', most, f'{f1[0]:.2f} / {f1[1]:.2f}'))
                if not loose:
                    took = 1e3 * float(np.median([result.processor_s for result in results]))
                    rows.append(('... processor time of an image, median', '', f'{took:.0f} ms'))
                    rows.append(('... frames without a drone that show one', f'< {false}', f'{m.false_frames(threshold):.3f}'))
            if loose:
                continue
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
    return rows


def elsewhere(detector: Detector, threshold: float, cache: Path, count: int) -> list[Row]:
    """Other people's pictures: of sets that may be trained on (the card says which were) and of those only judged on."""
    rows: list[Row] = []
    seen: list[Elsewhere] = []
    print('place      pictures drones  recall  false   ECE     found by share of the picture: '
          + ', '.join(f'from {share:.2f}' for share in SHARES[:-1]))
    for place in (*SOURCES, *JUDGED):
        one = look_at(detector, place, cache, count)
        seen.append(one)
        by_share = '  '.join(f'{one.recall(threshold, low, high):.2f}' for low, high in pairwise(SHARES))
        print(f'{place.name:10} {len(one.drones):8} {one.drones.sum():6}  {one.recall(threshold):.3f}   '
              f'{one.false_pictures(threshold):.3f}   {one.calibration_error():.3f}   {by_share}', flush=True)
        use = 'judged on only' if place in JUDGED else 'may be trained on'
        rows.append((f'pictures of {place.name} ({use}), recall at IoU 0.3 / pictures with a false drone',
                     'COCO + 0.10 / a quarter', f'{one.recall(threshold):.2f} / {one.false_pictures(threshold):.3f}'))
    judged = together(seen[len(SOURCES):])
    share, number = judged.right_at_half()
    near = f'{judged.recall(threshold, 0.5):.2f}'
    return [*rows, ('near drones of those judged on only, above half the picture', '0.85', near),
            ('calibration error on those judged on only', '0.10', f'{judged.calibration_error():.3f}'),
            ('... of boxes scored 0.4 to 0.6, right', '0.5', f'{share:.2f} of {number}')]


def rendered(detector: Detector, frames: Frames, sprites: list[NDArray], width: int, count: int = 120) -> list[Row]:
    """Recall of drones of builds never trained on, pasted over frames of clips never trained on, by size and background."""
    rows: list[Row] = []
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
            overlap, off = match(without_padding(detector.detect(canvas).boxes, detector.model.box_padding), box)
            good = overlap >= 0.3
            found.append(bool(good.any()))
            near += bool((off[good] <= max(5.0, 0.1 * size)).any())
        right, crowded = np.array(found), np.array(behind) > CROWD
        print(f'  {low:3}-{high:3} px: {right.mean():.3f}, centre within 5 px or a tenth of its size {near / count:.3f}; '
              f'before sky {right[~crowded].mean():.3f} of {np.sum(~crowded)}, '
              f'before other things {right[crowded].mean():.3f} of {np.sum(crowded)}', flush=True)
        if aim := BEFORE_THINGS.get(low):
            rows.append((f'rendered drones of {low} to {high} pixels before woods, fields, houses', aim,
                         f'{right[crowded].mean():.2f} of {np.sum(crowded)}'))
    return rows


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
                overlap, _ = match(without_padding(found.boxes, detector.model.box_padding), truth[:, 1:])
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


def figures(model: Path, classes: tuple[str, ...], args: argparse.Namespace) -> list[Row]:
    """Every figure of one detector, printed; the rows of the table that compares it with others."""
    rename, size = dict.fromkeys(classes, 'drone'), 0 if classes else args.size
    settings = DetectorSettings(keep=('drone',), rename=rename, input_size=size)
    plain, low = Detector(model, settings), Detector(model, replace(settings, score_threshold=LOWEST))
    threshold = plain.threshold
    rows: list[Row] = []
    print(f'\n{model.name}, threshold {threshold}')
    if 'real' in args.only:
        rows += real(low, threshold, args.data, args.clips, args.regions)
    if 'elsewhere' in args.only:
        rows += elsewhere(low, threshold, args.cache, args.count)
    if 'rendered' in args.only:
        sprites, frames = build_bank(args.cache, 'test')['drone'], Frames(args.cache, 'test_clip', 'test_scene')
        print('rendered drones, recall at IoU 0.3, 512 x 512 images:')
        rows += rendered(plain, frames, sprites, HEIGHT)
        print(f'1280 x 512 images in tiles of {SLICE}:')
        rendered(Detector(model, replace(settings, slice_size=SLICE)), frames, sprites, 1280, 60)
    if 'simulator' in args.only:
        print('simulator, a drone of 0.5 m at 3 to 20 m:')
        simulator(low, threshold)
    return rows


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('model', type=Path)
    parser.add_argument('--cache', type=Path, required=True, help='folder for frames (7 GB), renders, pictures (1 GB)')
    parser.add_argument('--data', type=Path, required=True, help='the drone_detection data set')
    parser.add_argument('--coco', type=Path, help='a COCO model to be measured beside it')
    parser.add_argument('--size', type=int, default=0, help="longer side of the input in pixels; 0: the metadata's")
    parser.add_argument('--regions', type=int, default=2, help='regions of a frame that are searched; 0: all of it')
    parser.add_argument('--count', type=int, default=300, help='pictures of each place')
    parser.add_argument('--clips', action='store_true', help='of each real clip, too')
    parser.add_argument('--only', nargs='+', choices=PARTS, default=PARTS)
    args = parser.parse_args()
    build_cache(args.data, args.cache)
    subjects = [(args.model, ())] + ([(args.coco, COCO_CLASSES)] if args.coco else [])
    tables = [figures(model, classes, args) for model, classes in subjects]
    print('\n| | aim | ' + ' | '.join(model.stem for model, _ in subjects) + ' |\n' + '|---' * (2 + len(subjects)) + '|')
    for rows in zip(*tables, strict=True):
        print(f'| {rows[0][0]} | {rows[0][1]} | ' + ' | '.join(row[2] for row in rows) + ' |')


if __name__ == '__main__':
    main()
