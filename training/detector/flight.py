"""Fit what motion says (`av_vision.motion`) to the labelled paths of the training clips, and write it into a model's metadata.

`python flight.py MODEL.onnx --data DRONE_DETECTION` needs no images. Logistic regression on the logarithm of the acceleration
of drones against airplanes and helicopters, each class counting alike; paths that hardly move are left out, as the detector
does. Birds bend their paths as drones do: they would only blunt what the others tell.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path as File

import numpy as np
import onnx
from clips import RATE, STRIDE, clips_of, folder_of, read_boxes
from numpy.typing import NDArray
from scipy.optimize import minimize
from tight import PADDING

from av_vision.motion import DECIDED, FAINT, HISTORY_S, MotionModel, Path

OTHERS = ('AIRPLANE', 'HELICOPTER')
EVERY_S = 0.5  # between the paths that are taken from a clip
SPECK = 8.0  # pixels, below which networks tell drones from other things badly


def paths(data: File, split: str, camera: str = 'V') -> Iterator[tuple[str, float, float, float]]:
    """Class, speed (sizes/s), acceleration (sizes/s^2) and size (pixels) of labelled paths, of clips of one object at a time.

    Parameters:
        data: the data set.
        split: the clips.
        camera: visible (V), of whose labels the padding is taken away as the detector does, or infrared (IR).
    """
    padding = PADDING if camera == 'V' else 0.0 * PADDING
    for clip in clips_of(data, split, camera):
        boxes = read_boxes(data / folder_of(clip, 'labels') / f'{clip}.csv')
        path, last, next_s = Path(), -np.inf, HISTORY_S
        for frame in sorted(boxes)[::STRIDE]:
            time, box = frame / RATE, np.array(boxes[frame][0][1:])
            if len(boxes[frame]) > 1 or time - last > 0.5:  # s, a gap
                path, next_s = Path(), time + HISTORY_S
            last = time
            path.add(time, 0.5 * (box[:2] + box[2:]), float((box[2:] - box[:2] - padding).max()))
            if time >= next_s:
                speed, acceleration, _ = path.motion()
                yield clip.split('_')[1], speed / path.size, acceleration / path.size, path.size
                next_s = time + EVERY_S


def fit(kinds: NDArray, speeds: NDArray, accelerations: NDArray, sizes: NDArray, camera: str = 'V') -> MotionModel:
    """The model under which the classes of paths (n,) are most likely.

    Parameters:
        kinds, speeds, accelerations, sizes: the paths, see `paths`.
        camera: visible (V), or infrared (IR), where nothing at rest looks like a drone (`specks.py`).
    """
    least_speed = MotionModel.least_speed
    used = (speeds >= least_speed) & np.isin(kinds, ('DRONE', *OTHERS))
    small = (accelerations * sizes)[(kinds == 'DRONE') & (sizes < SPECK)]
    kinds, x = kinds[used], np.log(accelerations[used] + FAINT)
    drone = kinds == 'DRONE'
    weight = np.where(drone, 0.5 / drone.sum(), 0.0)
    for kind in OTHERS:
        weight[kinds == kind] = 0.5 / len(OTHERS) / np.sum(kinds == kind)

    def unlikelihood(p: NDArray) -> float:
        z = p[0] * (x - p[1])
        return float(np.sum(weight * (np.logaddexp(0.0, z) - drone * z)))

    gain, neutral = minimize(unlikelihood, [1.0, 0.0]).x
    model = MotionModel(round(float(gain), 3), round(float(np.exp(neutral) - FAINT), 3), least_speed)
    if camera == 'IR':
        return model
    bends = np.log(small[small > 0.0])
    return replace(model, speck=SPECK, bend=round(float(np.exp(np.median(bends))), 2), bends=round(float(bends.std()), 2),
                   rests=round(DECIDED, 2))


def write_metadata(path: File, **values: str) -> None:
    """Add values to the metadata of a model."""
    model = onnx.load(str(path))
    onnx.helper.set_model_props(model, {one.key: one.value for one in model.metadata_props} | values)
    onnx.save(model, str(path))


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('model', type=File)
    parser.add_argument('--data', type=File, required=True)
    parser.add_argument('--thermal', action='store_true', help='infrared clips, for a thermal detector')
    args = parser.parse_args()
    camera = 'IR' if args.thermal else 'V'
    columns = [np.array(part) for part in zip(*paths(args.data, 'train', camera), strict=True)]
    model = fit(*columns, camera)
    write_metadata(args.model, motion=json.dumps(asdict(model)))
    print(f'{np.isin(columns[0], ("DRONE", *OTHERS)).sum()} paths: {model}')


if __name__ == '__main__':
    main()
