"""Figures of judgements by second of sound, and those of a model by recordings of others."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from material import ESC10, mono
from numpy.typing import NDArray
from scenes import Scenes, crop

from av_audio.drone_model import DroneModel

FALSE_SHARE = 0.05
QUIETEST = 1e-4  # standard deviation, of full scale, below which a second is silence


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


def report(title: str, log_odds: NDArray, labels: NDArray, kinds: NDArray) -> None:
    """Print ROC area, share of drones found where FALSE_SHARE of the rest is false, calibration, and all of it by kind.

    Parameters:
        title: of what is judged.
        log_odds (n,): of each second.
        labels (n,): whether it is a drone's.
        kinds (n,): of its source.
    """
    drones, others = log_odds[labels], log_odds[~labels]
    threshold = float(np.quantile(others, 1.0 - FALSE_SHARE))
    print(f'{title}: ROC area {roc_area(drones, others):.3f}, found {np.mean(drones > threshold):.3f} at {FALSE_SHARE:.0%} '
          f'false (log-odds {threshold:.2f}), calibration error {calibration_error(log_odds, labels):.3f}')
    for kind in sorted(set(kinds)):
        own = log_odds[kinds == kind]
        print(f'  {kind:22} {len(own):5d} s, above that {np.mean(own > threshold):.2f}, above 0 {np.mean(own > 0.0):.2f}, '
              f'log-odds {np.quantile(own, 0.1):5.1f} {np.median(own):5.1f} {np.quantile(own, 0.9):5.1f}')


def outside(model: DroneModel, folder: Path, rng: np.random.Generator, each: int = 30) -> tuple[NDArray, NDArray, NDArray]:
    """Log-odds (n,), labels and kinds of a second each of drones and of ESC-50 without ESC-10, in scenes at 0 to 25 dB.

    Parameters:
        model: what is judged.
        folder: `Multiclass_Drone_Audio` of DroneAudioDataset (Al-Emadi et al., IWCMC 2019), files of one second.
        rng: source of random numbers.
        each: number of files of each class of ESC-50, and a tenth of those of each drone.
    """
    scenes, chosen = Scenes(rng, as_recorded=0.7), list[tuple[Path, str]]()
    others: dict[int, list[Path]] = {}
    for path in sorted((folder / 'unknown').glob('[1-5]-*-*-*.wav')):
        number = path.stem.rsplit('-', 1)[1][:-1]  # the last digit is that of the second
        if number.isdigit() and int(number) not in ESC10:
            others.setdefault(int(number), []).append(path)
    for number, paths in sorted(others.items()):
        chosen += [(paths[k], f'ESC-50 class {number}') for k in rng.permutation(len(paths))[:each]]
    for name in ('bebop_1', 'membo_1'):
        paths = sorted((folder / name).iterdir())
        chosen += [(paths[k], f'{name} drone') for k in rng.permutation(len(paths))[:10 * each]]
    log_odds, kinds = list[float](), list[str]()
    for path, kind in chosen:
        samples = mono(path)
        if np.std(samples) > QUIETEST:
            log_odds.append(model.log_odds(*scenes.example(crop(samples, rng), None, rng.uniform(0.0, 25.0), 0.0)))
            kinds.append(kind)
    return np.array(log_odds), np.array([kind.endswith('drone') for kind in kinds]), np.array(kinds)


def main() -> None:
    """Judge a model by recordings of others: drones and kinds of sound on which it was not trained."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument('model', type=Path)
    parser.add_argument('folder', type=Path, help='Multiclass_Drone_Audio of DroneAudioDataset')
    arguments = parser.parse_args()
    report(arguments.model.name, *outside(DroneModel.load(arguments.model), arguments.folder, np.random.default_rng(7)))


if __name__ == '__main__':
    main()
