"""ros2 run av_evaluation soak: an hour of the whole rig, with a recorder and a page that somebody looks at.

Its processes keep memory, threads, descriptors; no sound is lost.
"""

from __future__ import annotations

import argparse
import math
import signal
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from av_evaluation.processes import launched_rig
from av_evaluation.soak import Limits, PageViewer, ProcessHistory, format_histories, lost_sound, save_histories, watch

EVERY_S = 5.0  # between samples
RIG = ('model:=shipped', 'renderer:=flat', 'view:=true')


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(prog='soak', description=__doc__)
    parser.add_argument('rig', nargs='*', default=list(RIG), metavar='NAME:=VALUE',
                        help=f'arguments of rig.launch.py (default: {" ".join(RIG)})')
    parser.add_argument('--minutes', type=_positive, default=60.0, help='length of the run (%(default)s)')
    parser.add_argument('--settle', type=_positive, default=5.0,
                        help='minutes at the start that do not count, at most half of the run (%(default)s)')
    parser.add_argument('--most-growth', type=_positive, default=5.0, help="limit of a process' growth in MiB (%(default)s)")
    parser.add_argument('--out', type=Path, help="folder for table, samples, the rig's output and the monitor's files")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the rig and print the table; returns 0 where all processes stay as they are, 1 where not, 2 where the rig ends."""
    options = parse(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with ExitStack() as opened:
        bags = opened.enter_context(tempfile.TemporaryDirectory(prefix='soak_'))
        out = options.out or Path(bags)
        out.mkdir(parents=True, exist_ok=True)
        log = opened.enter_context((out / 'rig.log').open('wb'))
        given = [f'record:={bags}/soak.mcap', f'out:={out}', *options.rig]
        viewer = PageViewer(out / 'rig.log') if 'view:=true' in given else None
        try:
            with launched_rig(given, log) as rig:
                histories = watch(rig, 60.0 * options.minutes, EVERY_S)
                ended_early = rig.process.poll() is not None
                blank = viewer is not None and viewer.waits
        except KeyboardInterrupt:
            print('soak: interrupted', file=sys.stderr)
            return 2
        if ended_early:
            output = (out / 'rig.log').read_text(errors='replace').splitlines()[-20:]
            print('soak: the rig ended before its time:', *output, sep='\n', file=sys.stderr)
        faults = [f'sound lost on the way to the bridge: {lost}'] if (lost := lost_sound(Path(bags) / 'soak.mcap')) else []
        if viewer is not None:
            print(f'{viewer.updates} updates of the page')
            faults += ['the page showed nothing at the end'] if blank else []
        return _report(histories, faults, options) or 2 * ended_early


def _report(histories: Sequence[ProcessHistory], faults: Sequence[str], options: argparse.Namespace) -> int:
    limits = Limits(min(60.0 * options.settle, 30.0 * options.minutes), options.most_growth)
    end = max([history.times[-1] for history in histories], default=0.0)
    steady = bool(histories) and not any(history.faults(limits, end) for history in histories)
    table = format_histories(histories, limits, end)
    text = (f'{table}\n{end / 60.0:.1f} min, the first {limits.settle / 60.0:g} not counted, '
            f'growth at most {limits.growth:g} MiB, counts constant: {"holds" if steady else "MISSED"}\n'
            f'{"; ".join(faults) or "no sound lost on the way to the bridge"}')
    print(text)
    if options.out:
        (options.out / 'soak.txt').write_text(f'{text}\n')
        save_histories(histories, options.out / 'soak.csv')
    return 0 if steady and not faults else 1


def _positive(text: str) -> float:
    value = float(text)
    if not (value > 0.0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f'{text} is not a number above 0')
    return value
