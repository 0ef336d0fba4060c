"""Figures of judgements by second of sound."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FALSE_SHARE = 0.05


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
