"""`ros2 run av_vision detect INPUT`: detections in a video, an image or a folder of images, by the stage of detector_node."""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2

from av_common.arguments import not_negative, whole
from av_common.parameters import node_parameters
from av_common.track import DRONE
from av_vision.detections import Detections
from av_vision.drawing import draw
from av_vision.image import AutomaticGain
from av_vision.models import FILES
from av_vision.sources.capture import SourceError
from av_vision.sources.files import Recording, name_for_opencv
from av_vision.stage import make_detector
from av_vision.temporal_detector import TemporalDetector
from av_vision.yolo.detector import Detector
from av_vision.yolo.letterbox import letterbox

COLUMNS = ('frame', 'time', 'class', 'score', 'x', 'y', 'w', 'h', 'track')


def video_writer(path: Path, rate: float, size: tuple[int, int]) -> cv2.VideoWriter:
    """A video file to write. Raises SourceError when it cannot be written.

    Parameters:
        path: the file.
        rate (1/s): frames per second.
        size: height and width of all frames; OpenCV silently skips others.
    """
    name = name_for_opencv(path.expanduser().absolute())    # FFmpeg takes `a:b.mp4` for a protocol
    video = cv2.VideoWriter(name, cv2.VideoWriter.fourcc(*'mp4v'), rate, size[::-1])
    if not video.isOpened():
        raise SourceError(f'{name} cannot be written as a video')
    return video


def rows_of(index: int, time: float, detections: Detections, tracks: Iterable[int]) -> Iterator[dict]:
    """One dictionary of COLUMNS for each detection; x, y is the top-left corner, in pixels of the input.

    Parameters:
        index: number of the frame.
        time (s): its time in the recording.
        detections: its detections.
        tracks: track number of each detection.
    """
    rows = zip(detections.boxes.tolist(), detections.class_names, detections.scores.tolist(), tracks, strict=True)
    for (x1, y1, x2, y2), name, score, track in rows:
        yield {'frame': index, 'time': round(time, 4), 'class': name, 'score': round(score, 4), 'x': round(x1, 2),
               'y': round(y1, 2), 'w': round(x2 - x1, 2), 'h': round(y2 - y1, 2), 'track': track}


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog='detect', description=__doc__)
    parser.add_argument('input', type=Path, help='video, image or folder of images')
    parser.add_argument('--model', default='shipped', help='ONNX file of a YOLO detector, or the name of a detector of another '
                        'package (default: %(default)s)')
    parser.add_argument('--camera', choices=tuple(FILES), default='visible', help='black_hot: a thermal one that shows heat '
                        'dark (default: %(default)s)')
    parser.add_argument('--classes', default='', metavar='A,B', help='classes of the model to be reported as drone, '
                        'or all: every class under its own name (default: the class drone)')
    parser.add_argument('--threshold', type=float, default=0.0, help="least score (default: the model's own)")
    parser.add_argument('--size', type=whole, default=0, help='longer side of the image for the network (dynamic models)')
    parser.add_argument('--no-temporal-fusion', dest='temporal_fusion', action='store_false',
                        help='treat images independently, for a folder of unrelated images')
    parser.add_argument('--rate', type=not_negative, default=0.0, help="frames/s (default: the video's own, 30 for a folder)")
    form = parser.add_mutually_exclusive_group()
    form.add_argument('--csv', action='store_true', help='rows with a header (the default)')
    form.add_argument('--json', action='store_true', help='one JSON object per row')
    parser.add_argument('--output', type=Path, help='write the rows here instead of standard output')
    parser.add_argument('--save-video', type=Path, metavar='OUT', help='write the input with boxes drawn, as .mp4')
    parser.add_argument('--quiet', action='store_true', help='no progress')
    return parser.parse_args(arguments)


def detector_of(arguments: argparse.Namespace) -> Detector:
    """The detector that the command line names. Raises ModelError or ValueError."""
    every = arguments.classes == 'all'
    given = {'model': arguments.model, 'camera_kind': arguments.camera, 'score_threshold': arguments.threshold,
             'input_size': arguments.size, 'keep_classes': [''] if every else arguments.classes.split(',')}
    return make_detector(node_parameters('av_vision', 'detector_node', overrides=given), () if every else (DRONE,))


def run(arguments: argparse.Namespace) -> list[str]:
    """Detect and write; returns what was left out. Raises ValueError, OSError or SourceError."""
    recording = Recording(arguments.input, arguments.rate)
    temporal = TemporalDetector(detector_of(arguments), temporal_fusion=arguments.temporal_fusion)
    out = arguments.output.open('w', newline='') if arguments.output else sys.stdout
    video = None
    writer = csv.DictWriter(out, COLUMNS, lineterminator='\n')
    if not arguments.json:
        writer.writeheader()
    begun, gain = time.perf_counter(), AutomaticGain(arguments.camera != 'visible')
    for frame in recording.frames():
        image = gain.apply(frame.image, frame.time)
        detections, tracks = temporal.detect(255 - image if arguments.camera == 'black_hot' else image, frame.time)
        rows = rows_of(frame.index, frame.time, detections, tracks)
        if arguments.json:
            out.writelines(f'{json.dumps(row)}\n' for row in rows)
        else:
            writer.writerows(rows)
        if arguments.save_video:
            drawn = draw(frame.image, detections, tracks)
            if video is None:
                size = drawn.shape[0], drawn.shape[1]
                video = video_writer(arguments.save_video, recording.rate, size)
            video.write(letterbox(drawn, *size)[0])
        if not arguments.quiet and frame.index % 10 == 0:
            total = f' of {recording.count}' if recording.count else ''
            each = 1e3 * (time.perf_counter() - begun) / (frame.index + 1)
            print(f'\rframe {frame.index + 1}{total}, {each:.0f} ms each', end='', file=sys.stderr, flush=True)
    if not arguments.quiet:
        columns = temporal.detector.model.columns
        print(f'\nthe columns of {arguments.model} are {columns}' if columns else '', file=sys.stderr)
    if video is not None:
        video.release()
    if arguments.output:
        out.close()
    return [recording.problem] if recording.problem else []


def main(arguments: list[str] | None = None) -> int:
    """Entry point; 2 for an input or a model that cannot be used, also for a part of the input."""
    problems = []
    try:
        problems = run(parse(arguments))
    except BrokenPipeError:
        sys.stderr.close()
    except (ValueError, OSError, SourceError) as error:
        problems = [str(error)]
    for problem in problems:
        print(f'\ndetect: {problem}', file=sys.stderr)
    return 2 if problems else 0


if __name__ == '__main__':
    sys.exit(main())
