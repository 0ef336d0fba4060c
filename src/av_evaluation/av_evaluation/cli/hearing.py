"""`ros2 run av_evaluation hearing [SECTION ...]`: figures of the localizer against independent ground truth."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path

from av_common.arguments import number
from av_evaluation.hearing import free_field, rooms, wind_hiss
from av_evaluation.hearing.ego_noise import ego_noise
from av_evaluation.hearing.places import read_responses
from av_evaluation.hearing.signals import bright_rotors, flat, recordings, rotors
from av_evaluation.hearing.trials import Figure
from av_evaluation.runs.program import run_program


def sections(count: int, data: Path, responses: Sequence[Path] = ()
             ) -> dict[str, Callable[[], Iterator[Figure]]]:
    """The figures by section.

    Parameters:
        count: windows per figure.
        data: folder with the recordings.
        responses: see `rooms.heads`.
    """
    sources = {'bright rotors': bright_rotors, 'rotors': rotors, 'flat noise': flat}
    with suppress(FileNotFoundError):
        sources['drone recordings'] = recordings(data)
    return {
        'accuracy': partial(free_field.accuracy, count, sources),
        'bound': partial(free_field.bound, count),
        'robust': partial(rooms.robust, min(count, 150), sources, data),
        'heads': partial(rooms.heads, data, responses),
        'wind': partial(wind_hiss.wind, min(count, 150), sources),
        'hiss': partial(wind_hiss.hiss, min(count, 100), sources),
        'ego_noise': partial(ego_noise, min(count, 100), sources),
        'cost': free_field.cost,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures; returns 1 when one misses its bound."""
    parser = argparse.ArgumentParser(prog='hearing', description=__doc__)
    parser.add_argument('sections', nargs='*', metavar='SECTION', help=f'of {", ".join(sections(1, Path()))} (default: all)')
    parser.add_argument('--trials', type=number, default=400, help='windows per figure (default: %(default)s)')
    parser.add_argument('--data', type=Path, default=Path('../shared/data'),
                        help='folder with drone_detection and kemar (default: %(default)s)')
    parser.add_argument('--responses', type=Path, nargs='+', default=[], metavar='SOFA',
                        help='heads: measured responses of another head instead of KEMAR; with a second file, such as the same '
                             'head in a room, the first calibrates and the second tests')
    return run_program(_show, parser, arguments)


def _show(options: argparse.Namespace) -> int:
    for file in options.responses:
        read_responses(file)    # one that cannot be used is named at once
    known = sections(options.trials, options.data, options.responses)
    if unknown := set(options.sections) - set(known):
        raise ValueError(f'unknown section {", ".join(sorted(unknown))}; known are {", ".join(known)}')
    held = [_print(name, known[name]()) for name in options.sections or known]
    return 0 if all(held) else 1


def _print(name: str, figures: Iterable[Figure]) -> bool:
    """Print the figures of a section, which is left out where recordings or libraries are missing; returns whether all hold."""
    print(name, flush=True)
    held = True
    try:
        for figure in figures:
            print(figure, flush=True)
            held &= figure.holds
    except (FileNotFoundError, ImportError) as error:
        print(f'  skipped: {error}')
    return held
