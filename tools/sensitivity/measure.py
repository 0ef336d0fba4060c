"""How much each numeric constant of hearing or fusion matters: scores of the same cases with half and with twice of it.

    python3 tools/sensitivity/measure.py hearing|fusion [NAME ...] [--out FILE.csv] [--count N]

A score is the mean logarithm of the density at the truth (Good, Rational decisions, 1952): it falls with errors, with a sigma
that is too small or too large, with the wrong side and with misplaced confidence. A constant whose changes cost nothing is not
critical, or has no case here; one whose change is better is not where it ought to be. Needs the workspace and `../shared/data`.
"""

from __future__ import annotations

import argparse
import csv
import json
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from scaled import Constant, constants, scale

ROOT = Path(__file__).resolve().parents[2]
FACTORS = (0.5, 2.0)
# Modules without influence on what is scored: devices, files, nodes, programs, judging, and what users choose instead.
OTHERS = {
    'hearing': ('nodes', 'cli', 'device', 'file', 'calibration', 'drone_', 'health', 'wind', 'start_check',
                'verdict', 'spacing', 'audio.stage', 'lost_phase'),
    'fusion': ('nodes', 'calibration', 'consistency', 'gated', 'plain', 'posterior', 'reporter', 'evidence', 'converter',
               'vectors')}
PACKAGES = {'hearing': 'av_audio', 'fusion': 'av_fusion'}
COUNTS = {'hearing': 36, 'fusion': 2}  # windows or runs of each case
COLUMNS = ('module', 'constant', 'value', 'factor', 'change', 'deviation', 'worst', 'its change', 'best', 'its change')


def measure(stage: str, cases: Path) -> dict[str, list[float]]:
    """Scores by case, in a process that has imported nothing of the suite before.

    Parameters:
        stage: of PACKAGES.
        cases: file that `prepare` has written.
    """
    content = pickle.loads(cases.read_bytes())
    if stage == 'hearing':
        import hearing
        return hearing.scores(content)
    sys.path.insert(0, str(ROOT / 'src' / 'av_evaluation' / 'test'))
    import fusion
    return fusion.scores(content)


def prepare(stage: str, count: int, cases: Path) -> None:
    """Write what is scored to a file: windows of sound, or the number of runs.

    Parameters:
        stage: of PACKAGES.
        count: windows or runs of each case.
        cases: the file.
    """
    content: object = count
    if stage == 'hearing':
        import hearing
        content = hearing.cases(count, ROOT.parent / 'shared' / 'data')
    cases.write_bytes(pickle.dumps(content))


def run(stage: str, cases: Path, constant: Constant | None, factor: float) -> dict[str, list[float]]:
    """Scores by case of a process with a constant changed.

    Parameters:
        stage: of PACKAGES.
        cases: file that `prepare` has written.
        constant: None changes nothing.
        factor: of the constant.
    """
    words = [] if constant is None else [*constant, str(factor)]
    result = subprocess.run([sys.executable, __file__, stage, '--cases', str(cases), '--change', *words],
                            capture_output=True, text=True, check=False)
    if result.returncode:
        raise RuntimeError(f'{constant} times {factor}: {result.stderr.strip().splitlines()[-1]}')
    return json.loads(result.stdout.splitlines()[-1])


def row(constant: Constant, factor: float, before: dict[str, list[float]], after: dict[str, list[float]]) -> list[str]:
    """One of COLUMNS.

    Parameters:
        constant, factor: what was changed.
        before, after: scores by case.
    """
    changes = {name: np.subtract(after[name], before[name]) for name in before}
    means = {name: float(change.mean()) for name, change in changes.items()}
    every = np.concatenate(list(changes.values()))
    worst, best = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
    return [*constant, f'{factor:g}', f'{every.mean():+.3f}', f'{every.std() / np.sqrt(len(every)):.3f}',
            worst, f'{means[worst]:+.2f}', best, f'{means[best]:+.2f}']


def rows(stage: str, names: Sequence[str], factors: Sequence[float], count: int) -> Iterator[list[str]]:
    """The rows of the table, as they are measured.

    Parameters:
        stage: of PACKAGES.
        names: of the constants; all where empty.
        factors: by which they are multiplied.
        count: windows or runs of each case.
    """
    package = ROOT / 'src' / PACKAGES[stage] / PACKAGES[stage]
    chosen = [one for one in constants(package)
              if (one.name in names if names else not any(word in one.module for word in OTHERS[stage]))]
    with tempfile.TemporaryDirectory() as folder:
        cases = Path(folder) / 'cases'
        prepare(stage, count, cases)
        before = run(stage, cases, None, 1.0)
        for k, constant in enumerate(chosen):
            for factor in factors:
                try:
                    yield row(constant, factor, before, run(stage, cases, constant, factor))
                except RuntimeError as error:
                    print(f'left out: {error}', file=sys.stderr)
            print(f'{k + 1}/{len(chosen)} {constant.name}', file=sys.stderr)


def main() -> int:
    """Print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('stage', choices=list(PACKAGES))
    parser.add_argument('names', nargs='*', metavar='NAME', help='of the constants (default: all)')
    parser.add_argument('--factors', type=float, nargs='+', default=FACTORS, metavar='F',
                        help='default: %(default)s; 1e-9 and 1e9 tell what a rule buys')
    parser.add_argument('--out', type=Path, help='table as CSV (default: printed)')
    parser.add_argument('--count', type=int, help=f'windows or runs of each case (default: {COUNTS})')
    parser.add_argument('--cases', type=Path, help=argparse.SUPPRESS)
    parser.add_argument('--change', nargs='*', help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.cases is not None:
        if options.change:
            *words, factor = options.change
            scale(Constant(*words), float(factor))
        print(json.dumps(measure(options.stage, options.cases)))
        return 0
    with options.out.open('w', newline='') if options.out else sys.stdout as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        for line in rows(options.stage, options.names, options.factors, options.count or COUNTS[options.stage]):
            table.writerow(line)
            file.flush()
    return 0


if __name__ == '__main__':
    sys.exit(main())
