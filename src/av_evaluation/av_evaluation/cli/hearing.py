"""`ros2 run av_evaluation hearing [SECTION ...]`: figures of the localizer against independent ground truth."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from av_evaluation.hearing import accuracy, cost, delay, ego_rotors, motion, outliers, robust, scenes, several
from av_evaluation.hearing.figures import Figure
from av_evaluation.hearing.signals import bright_rotors, flat, recordings, rotors


def sections(count: int, data: Path, srp_dnn: Path | None = None) -> dict[str, Iterator[Figure]]:
    """The figures by section, computed when iterated; these raise FileNotFoundError when recordings are missing.

    Parameters:
        count: windows per figure.
        data: folder with the recordings.
        srp_dnn: weights of SRP-DNN, see `av_evaluation.hearing.srp_dnn`; None leaves it out.
    """
    sources = {'bright rotors': bright_rotors, 'rotors': rotors, 'flat noise': flat}
    clips = data / 'drone_detection' / 'audio'
    if clips.is_dir():
        sources['drone recordings'] = recordings(clips)
    return {
        'accuracy': accuracy.accuracy(count, sources),
        'methods': accuracy.methods(count),
        'interpolation': delay.interpolation(count),
        'bound': accuracy.bound(count),
        'sigma': accuracy.sigma(count, sources),
        'motion': motion.motion(min(count, 100), sources),
        'kemar': scenes.kemar(data),
        'outliers': outliers.outliers(min(count, 10), sources.get('drone recordings', rotors), data),
        'room': scenes.room(clips),
        'robust': robust.robust(min(count, 150), sources, data, srp_dnn),
        'square': scenes.square(count),
        'several': several.several(min(count, 100), sources),
        'ego-rotors': ego_rotors.ego_rotors(min(count, 100)),
        'speed': cost.speed(),
        'node': cost.node(),
        'memory': cost.memory(),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point. Exits with 1 when a figure misses its bound."""
    names = list(sections(1, Path()))
    parser = argparse.ArgumentParser(prog='hearing', description=__doc__)
    parser.add_argument('sections', nargs='*', metavar='SECTION', help=f'any of {", ".join(names)} (default: all)')
    parser.add_argument('--trials', type=int, default=400, help='windows per figure (default: %(default)s)')
    parser.add_argument('--data', type=Path, default=Path('../shared/data'),
                        help='folder with drone_detection and kemar (default: %(default)s)')
    parser.add_argument('--srp-dnn', type=Path, metavar='FILE',
                        help='weights of SRP-DNN for the section robust: exp/00000002/best_model.tar of BingYang-20/SRP-DNN')
    options = parser.parse_args(arguments)
    unknown = set(options.sections) - set(names)
    if unknown:
        parser.error(f'unknown section {", ".join(sorted(unknown))}; known are {", ".join(names)}')
    missed = 0
    figures = sections(options.trials, options.data, options.srp_dnn)
    for name in options.sections or names:
        print(name, flush=True)
        try:
            for figure in figures[name]:
                print(figure, flush=True)
                missed += not figure.holds
        except (FileNotFoundError, ImportError) as error:
            print(f'  skipped: {error}')
    sys.exit(1 if missed else 0)
