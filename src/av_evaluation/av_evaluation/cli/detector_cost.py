"""`ros2 run av_evaluation detector_cost [INPUT]`: time of the detector on this machine, beside that of the bare network.

The bare session and the complete detector run alternately, under the same load of the machine. Medians and best deciles are
printed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from av_vision.models import shipped_model
from av_vision.sources import SourceError
from av_vision.sources.files import Recording
from av_vision.temporal_detector import TemporalDetector
from av_vision.yolo import Detector, DetectorSettings
from av_vision.yolo.letterbox import fitting_size, letterbox, to_tensor


def milliseconds(call: Callable[[], object]) -> float:
    """Duration of a call in ms."""
    started = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - started)


def tensor_of(detector: Detector, image: NDArray) -> NDArray:
    """The input of the network for an image."""
    model = detector.model
    size = fitting_size(image.shape[0], image.shape[1], model.longest) if model.dynamic_size else model.size
    return to_tensor([letterbox(image, *size)[0]], model.layout.rgb, model.layout.scale, model.dtype)


def open_detector(path: Path, size: int, threads: int) -> Detector:
    """Open a detector, with the given input size if the model has dynamic input."""
    own = Detector(path, DetectorSettings(threads=threads))
    return Detector(path, DetectorSettings(threads=threads, input_size=size)) if own.model.dynamic_size and size else own


def compare(detectors: dict[str, Detector], images: list[NDArray], rounds: int) -> dict[str, NDArray]:
    """Times in ms (2, rounds) of the bare session and of the complete detector, for each detector, measured alternately."""
    times = {name: np.empty((2, rounds)) for name in detectors}
    temporal = {name: TemporalDetector(detector) for name, detector in detectors.items()}
    for k in range(rounds):
        image = images[k % len(images)]
        for name, detector in detectors.items():
            tensor = tensor_of(detector, image)
            times[name][0, k] = milliseconds(lambda: detector.model.run(tensor))  # noqa: B023
            times[name][1, k] = milliseconds(lambda: temporal[name].detect(image, 0.1 * k))  # noqa: B023
    return times


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog='detector_cost', description=__doc__.splitlines()[0])
    parser.add_argument('input', type=Path, nargs='?', help='video, image or folder (default: noise of 640 x 512)')
    parser.add_argument('--model', type=Path, action='append', help='ONNX file, may be repeated (default: the shipped one)')
    parser.add_argument('--size', type=int, default=0, help='longer side of the image for models with dynamic input')
    parser.add_argument('--square', action='store_true', help='square images, for a comparison with models of square input')
    parser.add_argument('--threads', type=int, default=0)
    parser.add_argument('--rounds', type=int, default=200)
    args = parser.parse_args(arguments)
    try:
        detectors = {path.name: open_detector(path, args.size, args.threads) for path in args.model or [shipped_model()]}
        images = [frame.image for frame in islice(Recording(args.input).frames(), 50)] if args.input else \
            [np.random.default_rng(0).integers(0, 256, (512, 640, 3), np.uint8)]
    except (ValueError, OSError, SourceError) as error:
        print(f'detector_cost: {error}', file=sys.stderr)
        return 2
    if args.square:
        images = [image[:min(image.shape[:2]), :min(image.shape[:2])] for image in images]
    print('model                          network ms    image to detections ms  ratio  (median; best tenth)')
    for name, (bare, whole) in compare(detectors, images, args.rounds).items():
        best = [float(np.percentile(t, 10)) for t in (bare, whole)]
        print(f'{name:30} {np.median(bare):10.2f} {np.median(whole):25.2f} {np.median(whole / bare):6.2f}  '
              f'({best[0]:.2f}, {best[1]:.2f}, {best[1] / best[0]:.2f})')
    return 0


if __name__ == '__main__':
    sys.exit(main())
