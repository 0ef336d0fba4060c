"""`ros2 run av_evaluation replay BAG --out OUT.mcap`: bearings and commands computed from a recorded bag."""

from __future__ import annotations

import argparse
import gc
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from av_bags.converters import FORMATS, AudioLayout
from av_bags.reader import Bag
from av_bags.topics import KINDS, parse_remappings
from av_bags.writer import BagWriter
from av_evaluation.replay.replay import STAGES, Replay, ReplaySettings
from av_evaluation.runs.evaluation import describe
from av_evaluation.runs.program import Progress, run_program


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code: 0, 1 when the bag cannot be replayed, 3 when messages of it could not be used."""
    gc.set_threshold(100_000)  # few objects here are cyclic: searching for them costs an eighth of the time
    parser = argparse.ArgumentParser(prog='replay', description=__doc__, epilog=f'names to remap: {", ".join(KINDS)}')
    add = parser.add_argument
    add('bag', help='mcap or sqlite3 (.db3), a file or a folder')
    add('--out', metavar='FILE', default='', help='bag for the results (.mcap, or a folder)')
    add('--report', metavar='DIR', default='', help='folder for metrics.json and a plot')
    add('--from', dest='stage', choices=STAGES, default='',
        help='compute from sound and images (raw), from directions and detections (doa), or take the recorded bearings; '
             'default: the earliest that the bag allows')
    add('--start', type=float, default=0.0, metavar='S', help='begin S seconds after the start of the bag')
    add('--duration', type=float, default=float('inf'), metavar='S', help='end after S seconds')
    add('--rig', default='', metavar='FILE', help="the rig's description; default: config/rig.yaml")
    add('--array', default='', metavar='FILE', help="an array file other than the rig's")
    add('--params', action='append', default=[], metavar='FILE', help="parameters as the nodes read them, on top of "
        'config/rig_params.yaml; can be repeated')
    add('--model', default='', metavar='FILE', help="a detector's ONNX file, or 'shipped'; default: the recorded detections")
    add('--classes', default='', metavar='A,B', help="the model's classes that are taken for the target")
    add('--remap', nargs='+', action='extend', default=[], metavar='NAME:=TOPIC', help='topics of other names in the bag')
    add('--namespace', default='', help='the namespace of the recorded rig')
    add('--audio-rate', type=int, default=0, metavar='HZ', help='for sound as bytes without a header: sample rate')
    add('--audio-channels', type=int, default=2, metavar='N', help='... number of channels (%(default)s)')
    add('--audio-format', default='S16LE', choices=FORMATS, help='... type of samples (%(default)s)')
    add('--commands', action='store_true', help='compute pointing commands, too; the recorded rig does not follow them')
    add('--quiet', action='store_true', help='print no progress')
    return run_program(replay, parser, arguments, refused=1)


def settings_of(options: argparse.Namespace) -> ReplaySettings:
    """Settings of the options. Raises BagError for a remapping that cannot be read."""
    layout = AudioLayout(options.audio_rate, options.audio_channels, options.audio_format) if options.audio_rate else None
    return ReplaySettings(
        stage=options.stage, rig=options.rig, array=options.array, model=options.model,
        classes=tuple(filter(None, options.classes.split(','))), parameters=tuple(options.params),
        remappings=parse_remappings(options.remap), namespace=options.namespace, audio=layout,
        commands=options.commands, start=options.start, duration=options.duration)


def replay(options: argparse.Namespace) -> int:
    """Replay and report. Raises ValueError or OSError with a message about the input."""
    with ExitStack() as opened:
        bag = opened.enter_context(Bag(options.bag))
        run = Replay(bag, settings_of(options))
        out = opened.enter_context(BagWriter(options.out)) if options.out else None
        length = min(bag.length - options.start, options.duration)
        print(f'replaying {length:.1f} s of {options.bag} from {run.stage}', file=sys.stderr)
        progress = Progress('s', options.quiet)
        progress.show(0.0, length)
        began, worked = time.monotonic(), time.process_time()
        log = run.run(out, lambda done: progress.show(done, length))
        progress.show(length, length)
        elapsed, busy = (max(spent, 1e-9) for spent in (time.monotonic() - began, time.process_time() - worked))
    for note in run.notes:
        print(f'  ! {note}', file=sys.stderr)
    print(describe(log, Path(options.report) if options.report else None))
    print(f'{length:.1f} s replayed in {elapsed:.2f} s: {length / elapsed:.0f} x real time '
          f'({length / busy:.0f} x by {busy:.2f} s of processor time)')
    return 3 if run.lost else 0
