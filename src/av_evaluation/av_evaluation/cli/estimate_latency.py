"""ros2 run av_evaluation estimate_latency BAG: offset between the stamps of sound and of images in a bag."""

from __future__ import annotations

import argparse
import sys

from av_bags.reader import Bag
from av_evaluation.replay.replay import Replay, ReplaySettings
from av_fusion.calibration.latency import estimate_offset

LARGEST_S = 0.6  # of offsets: more than any sensor's delay that was met, less than a second, which has aliases


def main(arguments: list[str] | None = None) -> int:
    """Print the offset and the parameter that compensates it; returns 1 where it cannot be estimated."""
    parser = argparse.ArgumentParser(prog='estimate_latency', description=__doc__)
    parser.add_argument('bag', help='mcap or sqlite3 (.db3), a file or a folder')
    options = parser.parse_args(arguments)
    try:
        with Bag(options.bag) as bag:
            log = Replay(bag, ReplaySettings()).run()
        sound, sight = log.sound['confidence'] >= 0.5, log.sight['score'] >= 0.5
        offset = estimate_offset((log.sound['time'][sound], log.sound['azimuth'][sound], log.sound['mirrored'][sound]),
                                 (log.sight['time'][sight], log.sight['azimuth'][sight]), LARGEST_S)
    except (ValueError, OSError) as error:
        print(f'estimate_latency: {error}', file=sys.stderr)
        return 1
    print(f'stamps of sound are {1e3 * offset.seconds:+.1f} ms (+-{1e3 * offset.sigma:.1f}) later than those of sight, '
          f'from {offset.pairs} pairs\nfusion_node: sound_delay: {offset.seconds:.3f}   (to be added to the present value)')
    return 0
