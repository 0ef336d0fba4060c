"""Measure a detector: `python evaluate.py MODEL.onnx --cache FOLDER --data DRONE_DETECTION` prints the model card's tables.

With `--coco MODEL` a COCO model, whose airplanes, birds and kites are drones, is measured on the same images beside it.
`--quick` takes every fifth clip and a fifth of all other images.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from itertools import chain, pairwise, product
from pathlib import Path

import numpy as np
from clips import HEIGHT, Frames, build_cache
from elsewhere import SHARES, Elsewhere, look_at, together
from live import beside_the_rig
from measure import (
    BANDS,
    FrameResult,
    Measurement,
    Row,
    calibration_error,
    detect_all,
    longer_sides,
    measure,
    right_at_half,
)
from places import JUDGED, SOURCES, Place
from renders import CLUTTER, SUN, against_sun, clutter, rendered, simulator
from sprites import build_bank

from av_vision import Detector, DetectorSettings, TemporalDetector
from av_vision.yolo.model import parsed

LOWEST = 0.02
COCO_CLASSES = ('airplane', 'bird', 'kite')  # what a drone is taken for
PARTS = ('real', 'elsewhere', 'rendered', 'simulator', 'live')  # of a visible detector
THERMAL = ('thermal', 'black_hot')  # of a thermal one: the clips as they are, and inverted without being told
QUICK = 5

AIMS = {'test_clip': ('known places', '0.93 / 0.80', '0.03'), 'test_scene': ('new places', '0.90 / 0.78', '0.08')}


def real(detector: Detector, alone: float, args: argparse.Namespace, kind: str = 'V', inverted: bool = False) -> list[Row]:
    """The held-out clips, by split: every third frame in order, each by itself and with time, as a rig searches them.

    Parameters:
        detector: the detector.
        alone: threshold of single images.
        args: the command line.
        kind: visible (V) or infrared (IR) clips.
        inverted: whether they are shown as negatives.
    """
    rows: list[Row] = []
    in_time = TemporalDetector(detector).model.threshold or alone
    print(f'threshold of single images {alone}, of tracks {in_time}')
    print('split      results       boxes    frames drones  F1@.3  F1@.5  P@.3   R@.3   AP@.3  AP@.5  <5 px  false  ECE')
    for split in ('validation', 'test_clip', 'test_scene') if kind == 'V' else ('validation', 'test_clip'):
        results = detect_all(detector, args.data, split, args.regions, QUICK if args.quick else 1, kind, inverted)
        labels = (True, False) if kind == 'V' else (False,)  # tight boxes of infrared clips are not known
        for fused, loose in product((False, True), labels):
            threshold = in_time if fused else alone
            m = measure(results, detector, fused, loose)
            figures = (m.f1(threshold), m.f1(threshold, 0.5), m.precision(threshold), m.recall(threshold),
                       m.average_precision(0.3), m.average_precision(0.5), m.centred(threshold), m.false_frames(threshold),
                       calibration_error(m.scores, m.hits))
            how = f'{"in time" if fused else "by themselves":13} {"labels" if loose else "tight":6}'
            row = '  '.join(f'{figure:.3f}' for figure in figures)
            print(f'{split:10} {how} {len(results):8} {m.drones.sum():6}  {row}', flush=True)
            if kind == 'IR' and split == 'test_clip':
                rows += rows_of_infrared(m, threshold, fused, 'inverted infrared clips' if inverted else 'infrared clips')
            elif fused and split in AIMS:
                rows += rows_of_clips(split, m, threshold, loose)
            if not loose:
                kinds = by_kind(results, m, threshold, args.clips and fused)
                rows += kinds if fused and split == ('test_scene' if kind == 'V' else 'test_clip') else []
        if split in AIMS:
            took = 1e3 * float(np.median([result.processor_s for result in results]))
            rows.append((f'... processor time of an image, {AIMS[split][0]}, median', '', f'{took:.0f} ms'))
    return rows


def rows_of_clips(split: str, m: Measurement, threshold: float, loose: bool) -> list[Row]:
    """The table's rows of a split, in time, as labelled or with tight boxes."""
    name, aim, false = AIMS[split]
    f1 = f'{m.f1(threshold):.2f} / {m.f1(threshold, 0.5):.2f}'
    if loose:
        return [(f'clips of {name}, F1 at IoU 0.3 / 0.5, boxes as labelled', '', f1)]
    right, number = right_at_half(m.scores, m.hits)
    return [(f'clips of {name}, F1 at IoU 0.3 / 0.5, tight boxes', aim, f1),
            ('... frames without a drone that show one', f'< {false}', f'{m.false_frames(threshold):.3f}'),
            ('... calibration error', '0.10', f'{calibration_error(m.scores, m.hits):.3f}'),
            ('... of boxes scored 0.4 to 0.6, right', '0.5', f'{right:.2f} of {number}')]


def rows_of_infrared(m: Measurement, threshold: float, fused: bool, clips: str) -> list[Row]:
    """The table's rows of infrared clips that were not trained on, boxes as labelled."""
    how = 'in time, as a rig sees them' if fused else 'images by themselves'
    return [(f'{clips}, {how}, F1 at IoU 0.3 / 0.5', '0.85', f'{m.f1(threshold):.2f} / {m.f1(threshold, 0.5):.2f}'),
            ('... frames without a drone that show one', '< 0.05', f'{m.false_frames(threshold):.3f}'),
            ('... calibration error', '0.10', f'{calibration_error(m.scores, m.hits):.3f}')]


def by_kind(results: list[FrameResult], m: Measurement, threshold: float, clips: bool) -> list[Row]:
    """False drones by what is there instead, drones found by size; printed, and as rows of the table."""
    rows: list[Row] = []
    clip, sizes = np.array([result.clip for result in results]), longer_sides(results)
    wrong = np.unique(m.frames[(m.scores >= threshold) & ~m.hits])
    right = np.unique(m.frames[(m.scores >= threshold) & m.hits])
    for kind in ('BIRD', 'AIRPLANE', 'HELICOPTER'):
        mine = np.array([kind in name for name in clip])
        if mine.any():
            print(f'           false drones on {kind.lower()} frames: {mine[wrong].sum()} of {mine.sum()}')
            rows.append((f'... frames of {kind.lower()}s with a false drone', '< 0.08',
                         f'{mine[wrong].sum() / mine.sum():.3f} of {mine.sum()}'))
    for low, high in BANDS:
        mine = (sizes >= low) & (sizes < high)
        if mine.any():
            found, hits = mine[right].sum() / mine.sum(), m.hits & (m.scores >= threshold) & mine[m.frames]
            sigma = np.sqrt(0.5 * np.mean(m.offsets[hits]**2)) if hits.any() else np.nan  # of each axis
            print(f'           drones of {low:3}-{high:3} px: found {found:.3f} of {mine.sum()}, centres within {sigma:.2f} px')
            rows.append((f'... drones of {low} to {high} pixels found, error of their centres', '',
                         f'{found:.2f} of {mine.sum()}, {sigma:.1f} px'))
    for name in np.unique(clip) if clips else ():
        mine = clip == name
        print(f'           {name:17} found in {mine[right].sum():3}, false in {mine[wrong].sum():3} of {mine.sum():3}')
    return rows


def elsewhere(detector: Detector, threshold: float, args: argparse.Namespace) -> list[Row]:
    """Other people's pictures, one set after the other; which of them a network was trained on its metadata say."""
    rows: list[Row] = []
    unseen: list[Elsewhere] = []
    print('place      pictures drones  recall  false   ECE     found by share of the picture: '
          + ', '.join(f'from {share:.2f}' for share in SHARES[:-1]))
    for place in chosen(args):
        one = look_at(detector, place, args.cache, args.count // (QUICK if args.quick else 1))
        by_share = '  '.join(f'{one.recall(threshold, low, high):.2f}' for low, high in pairwise(SHARES))
        print(f'{place.name:10} {len(one.drones):8} {one.drones.sum():6}  {one.recall(threshold):.3f}   '
              f'{one.false_pictures(threshold):.3f}   {calibration_error(one.scores, one.hits):.3f}   {by_share}', flush=True)
        unseen += [] if place.name in args.known else [one]
        use = 'trained on' if place.name in args.known else 'not trained on'
        rows.append((f'pictures of {place.name} ({use}), recall at IoU 0.3 / pictures with a false drone',
                     '' if place.name in args.known else 'COCO + 0.10 / a quarter',
                     f'{one.recall(threshold):.2f} / {one.false_pictures(threshold):.3f}'))
        if one.nameless.any():
            balloons = one.nameless & (one.drones == 0)
            rows.append(('... of those with balloons and no drone', '',
                         f'{one.false_pictures(threshold, balloons):.3f} of {balloons.sum()}'))
    return [*rows, *rows_of_unseen(together(unseen) if unseen else None, threshold)]


def rows_of_unseen(one: Elsewhere | None, threshold: float) -> list[Row]:
    """The table's rows of all pictures of sets that were not trained on."""
    share, number = right_at_half(one.scores, one.hits) if one else (np.nan, 0)
    near, error = (one.recall(threshold, 0.5), calibration_error(one.scores, one.hits)) if one else (np.nan, np.nan)
    return [('near drones of sets not trained on, above half the picture', '0.85', f'{near:.2f}'),
            ('calibration error on sets not trained on', '0.10', f'{error:.3f}'),
            ('... of boxes scored 0.4 to 0.6, right', '0.5', f'{share:.2f} of {number}')]


def trained_on(model: Path) -> set[str]:
    """The sets that the networks of a detector were trained on, as the metadata say."""
    detector = Detector(model)
    return {place for one in (detector.model, detector.near) for place in parsed(one.metadata.get('places', '[]'))}


def chosen(args: argparse.Namespace) -> list[Place]:
    """The sets that the command line names; by default those that may be trained on."""
    return [place for place in (*SOURCES, *JUDGED) if place.name in args.places]


def pasted(plain: Detector, args: argparse.Namespace) -> list[Row]:
    """Renders pasted over frames: drones by size and background, against the sun, and what is taken for one."""
    part = QUICK if args.quick else 1
    bank, frames = build_bank(args.cache, 'test'), Frames(args.cache, 'test_clip', 'test_scene')
    print('rendered drones, recall at IoU 0.3, 512 x 512 images:', flush=True)
    rows = rendered(plain, frames, bank['drone'], HEIGHT, 120 // part)
    sun = against_sun(plain, frames, bank['drone'], SUN // part)
    for row in chain(sun, clutter(plain, frames, bank['other'], CLUTTER // part)):
        print(f'  {row[0]}: {row[2]}', flush=True)
        rows.append(row)
    return rows


def figures(model: Path, classes: tuple[str, ...], args: argparse.Namespace) -> list[Row]:
    """Every figure of one detector, printed; the rows of the table that compares it with others."""
    rename, size = dict.fromkeys(classes, 'drone'), 0 if classes else args.size
    settings = DetectorSettings(keep=('drone',), rename=rename, input_size=size)
    plain, low = Detector(model, settings), Detector(model, replace(settings, score_threshold=LOWEST))
    threshold, began = plain.threshold, time.monotonic()
    rows: list[Row] = []
    print(f'\n{model.name}, threshold {threshold}')
    for part in THERMAL:
        rows += real(low, threshold, args, 'IR', part == 'black_hot') if part in args.only else []
    if 'real' in args.only:
        rows += real(low, threshold, args)
    if 'elsewhere' in args.only:
        rows += elsewhere(low, threshold, args)
    if 'rendered' in args.only:
        rows += pasted(plain, args)
    if 'simulator' in args.only:
        print('simulator, a drone of 0.5 m at 3 to 20 m:', flush=True)
        simulator(low, threshold, 80 // (QUICK if args.quick else 1))
    for cores in (2, 1) if 'live' in args.only else ():
        rows += beside_the_rig(model, classes, cores)
    print(f'{model.name}: {time.monotonic() - began:.0f} s', file=sys.stderr, flush=True)
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
    parser.add_argument('--places', nargs='*', default=[place.name for place in SOURCES], help='sets of pictures (places.py)',
                        choices=[place.name for place in (*SOURCES, *JUDGED)])
    parser.add_argument('--clips', action='store_true', help='of each real clip, too')
    parser.add_argument('--quick', action='store_true', help='a fifth of everything')
    parser.add_argument('--only', nargs='+', choices=(*PARTS, *THERMAL), default=PARTS)
    args = parser.parse_args()
    if {'real', 'rendered'} & set(args.only):
        build_cache(args.data, args.cache)
    subjects = [(args.model, ())] + ([(args.coco, COCO_CLASSES)] if args.coco else [])
    args.known = trained_on(args.model)
    tables = [figures(model, classes, args) for model, classes in subjects]
    print('\n| | aim | ' + ' | '.join(model.stem for model, _ in subjects) + ' |\n' + '|---' * (2 + len(subjects)) + '|')
    for rows in zip(*tables, strict=True):
        print(f'| {rows[0][0]} | {rows[0][1]} | ' + ' | '.join(row[2] for row in rows) + ' |')


if __name__ == '__main__':
    main()
