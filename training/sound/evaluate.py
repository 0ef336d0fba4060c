"""Judges per second of sound: recordings by models that do not know them, drones and sounds of other places by the model."""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import rendered
from material import ELSEWHERE, FOLDS, KNOWN, RATE, Recording, recordings
from numpy.typing import NDArray
from scenes import SAMPLES, Scenes

from av_audio.drone_model import DroneModel

FALSE_SHARE = 0.05
SNRS_DB = (20.0, 10.0, 0.0)
AS_RECORDED_DB = 40.0
SEED = 1000
QUIET = 0.1  # seconds whose level is below this share of their recording's are silence


def judged(items: Sequence[Recording], models: Mapping[int, DroneModel], snr_db: float) -> Iterator[tuple[Recording, NDArray]]:
    """Log-odds of each second of each recording, in a random scene with noise and without other sources.

    Parameters:
        items: the recordings.
        models: by the fold of the recording.
        snr_db (dB): signal-to-noise ratio; AS_RECORDED_DB for sounds as they were recorded.
    """
    scenes = Scenes(np.random.default_rng(SEED), as_recorded=float(snr_db == AS_RECORDED_DB))
    for item in items:
        samples = item.samples if len(item.samples) >= SAMPLES else np.tile(item.samples, SAMPLES // len(item.samples) + 1)
        parts = [samples[start:start + SAMPLES] for start in range(0, len(samples) - SAMPLES + 1, RATE)]
        parts = [part for part in parts if np.std(part) > QUIET * np.std(samples)]
        if parts:
            yield item, models[item.fold].log_odds(np.array([scenes.example(part, None, snr_db, 0.0) for part in parts]))


def roc_area(drones: NDArray, others: NDArray) -> float:
    """Probability that a second of a drone scores higher than one of something else (Mann and Whitney, 1947)."""
    ranks = np.argsort(np.argsort(np.concatenate([drones, others]))) + 1
    return float((ranks[:len(drones)].sum() - len(drones) * (len(drones) + 1) / 2) / (len(drones) * len(others)))


def calibration_error(log_odds: NDArray, labels: NDArray, bins: int = 10) -> float:
    """Expected calibration error for equal shares of drones and others (Guo et al., 2017)."""
    weights = np.where(labels, 0.5 / labels.sum(), 0.5 / (~labels).sum())
    probability = 1.0 / (1.0 + np.exp(-log_odds))
    places = np.minimum((probability * bins).astype(int), bins - 1)
    return float(sum(abs(np.sum(weights[places == k] * (labels[places == k] - probability[places == k]))) for k in range(bins)))


def report(title: str, results: Sequence[tuple[Recording, NDArray]]) -> None:
    """Print ROC area, share of drones found where FALSE_SHARE of the rest is false, and that by kind."""
    by_kind: dict[str, list[NDArray]] = defaultdict(list)
    for item, log_odds in results:
        by_kind[item.kind].append(log_odds)
    values = {kind: np.concatenate(parts) for kind, parts in by_kind.items()}
    drones = np.concatenate([v for kind, v in values.items() if kind.endswith('drone')])
    others = np.concatenate([v for kind, v in values.items() if not kind.endswith('drone')])
    threshold = float(np.quantile(others, 1.0 - FALSE_SHARE))
    labels = np.repeat([True, False], [len(drones), len(others)])
    found, error = np.mean(drones > threshold), calibration_error(np.concatenate([drones, others]), labels)
    print(f'{title}: ROC area {roc_area(drones, others):.3f}, found {found:.3f} at {FALSE_SHARE:.0%} false, '
          f'calibration error {error:.3f}')
    print('  ' + ', '.join(f'{kind} {np.mean(v > threshold):.2f} ({len(v)} s)' for kind, v in sorted(values.items())))


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('model', type=Path)
    parser.add_argument('--clips', type=Path, required=True, help="folder of Svanstrom's clips of sound")
    parser.add_argument('--packages', type=Path, required=True, help='folder for the sounds of Debian packages')
    parser.add_argument('--repository', type=Path, help='git directory of the repository that material.py names')
    parser.add_argument('--folds', type=Path, required=True, help='folder of the models that do not know one fold each')
    arguments = parser.parse_args()
    models = {fold: DroneModel.load(arguments.folds / f'fold_{fold}.npz') for fold in range(1, FOLDS + 1)}
    models |= dict.fromkeys((KNOWN, ELSEWHERE), DroneModel.load(arguments.model))
    items = list(recordings(arguments.clips, arguments.packages, arguments.repository))
    drawn = list(rendered.recordings(np.random.default_rng(SEED), 60, 60))
    for snr_db in (AS_RECORDED_DB, *SNRS_DB):
        scene = 'as recorded' if snr_db == AS_RECORDED_DB else f'in scenes at {snr_db:g} dB'
        for title, part in (('unknown recordings', [item for item in items if item.fold > KNOWN]),
                            ('other places', [item for item in items if item.fold == ELSEWHERE]), ('rendered', drawn)):
            if part:
                report(f'{title}, {scene}', list(judged(part, models, snr_db)))


if __name__ == '__main__':
    main()
