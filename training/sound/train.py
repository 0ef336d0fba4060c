"""Trains, judges, calibrates and writes the model of drone sounds. See README.md."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rendered
from judge import report
from material import FOLDS, Recording, esc10, recordings
from numpy.typing import NDArray
from scenes import Scenes, crop
from sklearn.linear_model import LogisticRegression
from sklearn.neural_network import MLPClassifier

from av_audio.drone_model import LARGEST_FEATURE, DroneModel

# Shares of the examples of drones. The lines of an aeroplane are those of many machines: for a likelihood ratio above 1 its
# share must be well above that of one kind of machine. Chosen among 0.2 and 0.28 (model card).
DRONES = {'drone': 0.36, 'rendered drone': 0.36, 'aeroplane drone': 0.28}
HIDDEN = (64, 32)
RENDERED = (400, 80)  # sounds of each build of drones, and of each other kind
SNRS_DB, AS_RECORDED = (-5.0, 35.0), 0.4  # of the examples
# Share of the examples of others that are hardly there: the direction is that of noise which the microphones do not share.
ABSENT, ABSENT_DB = 0.1, (-30.0, -5.0)
# Share of the scenes with a second source; of those, share in which its direction is known; and how much louder than what is
# judged it is at most: beside something else, beside a drone.
BESIDE, SEPARATED = 0.35, 0.6
QUIETER_DB, LOUDER_DB, LOUDER_SEPARATED_DB = -25.0, (-3.0, 3.0), (3.0, 14.0)
EPOCHS, PENALTY = 40, 1.0  # PENALTY is scikit-learn's alpha


class Material:
    """Draws sounds of one fold: of a drone, or of one of the other kinds, alike often.

    Parameters:
        items: recordings of the fold.
        rng: source of random numbers.
    """

    def __init__(self, items: Sequence[Recording], rng: np.random.Generator) -> None:
        kinds = {one.kind for one in items}
        self._rng, self._by_kind = rng, {kind: [one for one in items if one.kind == kind] for kind in kinds}
        self._others = sorted(kind for kind, (one, *_) in self._by_kind.items() if not one.is_drone)

    def drone(self) -> tuple[NDArray, str]:
        """Sound of a drone, and its kind."""
        kind = str(self._rng.choice(list(DRONES), p=list(DRONES.values())))
        return self._of_kind(kind, *((1.0, 1.0) if kind == 'aeroplane drone' else (0.65, 1.5)))

    def other(self) -> tuple[NDArray, str]:
        """Sound of something else, and its kind."""
        return self._of_kind(str(self._rng.choice(self._others)), 0.8, 1.25)

    def _of_kind(self, kind: str, slowest: float, fastest: float) -> tuple[NDArray, str]:
        items = self._by_kind[kind]
        part = crop(items[int(self._rng.integers(len(items)))].samples, self._rng)
        speed = np.exp(self._rng.uniform(np.log(slowest), np.log(fastest)))
        places = np.arange(len(part)) * speed  # played faster or slower, as something of another size would sound
        return np.interp(places % (len(part) - 1), np.arange(len(part)), part), kind


def examples(material: Material, scenes: Scenes, count: int, rng: np.random.Generator) -> tuple[NDArray, NDArray, NDArray]:
    """Features (count, n), labels (count,) and kinds (count,) of random scenes; in half of them one listens to a drone.

    Parameters:
        material: the sounds.
        scenes: makes scenes of sounds.
        count: number of scenes.
        rng: source of random numbers.
    """
    features, labels, kinds = [], [], []
    for number in range(count):
        is_drone = number % 2 == 0
        source, kind = material.drone() if is_drone else material.other()
        other, separated, snr_db = None, bool(rng.random() < SEPARATED), rng.uniform(*SNRS_DB)
        if rng.random() < BESIDE:
            other = material.drone()[0] if not is_drone and rng.random() < 0.5 else material.other()[0]
        elif not is_drone and rng.random() < ABSENT:
            snr_db, kind = rng.uniform(*ABSENT_DB), 'nothing'
        louder_db = (LOUDER_SEPARATED_DB if separated else LOUDER_DB)[is_drone]
        features.append(scenes.example(source, other, snr_db, rng.uniform(QUIETER_DB, louder_db), separated))
        labels.append(is_drone)
        kinds.append(kind)
    return np.array(features), np.array(labels), np.array(kinds)


def fit(features: NDArray, labels: NDArray, seed: int, networks: int = 1) -> DroneModel:
    """A model without calibration. Several networks are joined into one, whose output is their mean."""
    mean, scale = features.mean(axis=0), features.std(axis=0) + 1e-3
    values = np.clip((features - mean) / scale, -LARGEST_FEATURE, LARGEST_FEATURE)
    fitted = [MLPClassifier(HIDDEN, alpha=PENALTY, batch_size=256, learning_rate_init=1e-3, max_iter=EPOCHS,
                            random_state=seed + k).fit(values, labels) for k in range(networks)]
    return DroneModel(_joined([list(zip(m.coefs_, m.intercepts_, strict=True)) for m in fitted]), mean, scale)


def _joined(networks: list[list[tuple[NDArray, NDArray]]]) -> list[tuple[NDArray, NDArray]]:
    """One network whose layers hold those of several side by side."""
    layers = []
    for number, parts in enumerate(zip(*networks, strict=True)):
        biases = np.concatenate([bias for _, bias in parts])
        if number == 0:
            weights = np.concatenate([weight for weight, _ in parts], axis=1)
        else:
            weights = np.zeros((sum(len(w) for w, _ in parts), len(biases)))
            row = column = 0
            for weight, _ in parts:
                weights[row:row + weight.shape[0], column:column + weight.shape[1]] = weight
                row, column = row + weight.shape[0], column + weight.shape[1]
        layers.append((weights, biases))
    weights, biases = layers[-1]
    layers[-1] = weights.mean(axis=1, keepdims=True), biases.mean(keepdims=True)
    return layers


def platt(outputs: NDArray, labels: NDArray) -> tuple[float, float]:
    """Slope and offset that make outputs (n,) log-odds (Platt, 1999), for equal shares of drones and others."""
    fitted = LogisticRegression(class_weight='balanced').fit(outputs[:, None], labels)
    return float(fitted.coef_[0, 0]), float(fitted.intercept_[0])


def left_out(made: dict[str, NDArray], seed: int, networks: int) -> NDArray:
    """Outputs (n,) of models that know neither the kinds of others nor the drones of the fold."""
    outputs = np.zeros(len(made['labels']))
    for fold in range(1, FOLDS + 1):
        own = made['folds'] == fold
        outputs[own] = fit(made['features'][~own], made['labels'][~own], seed, networks).log_odds(made['features'][own])
    return outputs


def judged(outputs: NDArray, labels: NDArray, folds: NDArray) -> NDArray:
    """Log-odds (n,) of outputs of `left_out`, each calibrated by the outputs of the other folds."""
    log_odds = np.zeros(len(outputs))
    for fold in range(1, FOLDS + 1):
        own = folds == fold
        slope, offset = platt(outputs[~own], labels[~own])
        log_odds[own] = slope * outputs[own] + offset
    return log_odds


def examples_of_folds(items: Sequence[Recording], count: int, rng: np.random.Generator) -> dict[str, NDArray]:
    """Features (m, n), labels, kinds and folds (m,); all sounds of a scene are of one fold, which can be left out.

    Parameters:
        items: recordings of all folds.
        count: number of seconds of sound.
        rng: source of random numbers.
    """
    parts = []
    for fold in range(1, FOLDS + 1):
        material = Material([item for item in items if item.fold == fold], rng)
        made = examples(material, Scenes(rng, AS_RECORDED), count // FOLDS, rng)
        parts.append((*made, np.full(len(made[1]), fold)))
    return dict(zip(('features', 'labels', 'kinds', 'folds'), map(np.concatenate, zip(*parts, strict=True)), strict=True))


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('out', type=Path, help='the model, such as ../../src/av_audio/models/drone_sound.npz')
    parser.add_argument('--clips', type=Path, required=True, help="folder of Svanstrom's clips of sound")
    parser.add_argument('--esc', type=Path, required=True, help='folder `audio` of ESC-50, of which ESC-10 is used')
    parser.add_argument('--count', type=int, default=42_000, help='number of examples')
    parser.add_argument('--networks', type=int, default=5, help='networks whose mean is taken')
    parser.add_argument('--features', type=Path, help='file that keeps the examples between runs')
    parser.add_argument('--seed', type=int, default=0)
    arguments = parser.parse_args()
    if arguments.features and arguments.features.exists():
        with np.load(arguments.features) as file:
            made = {name: file[name] for name in file.files}
    else:
        rng = np.random.default_rng(arguments.seed)
        items = [*recordings(arguments.clips), *esc10(arguments.esc), *rendered.recordings(rng, *RENDERED)]
        made = examples_of_folds(items, arguments.count, rng)
        if arguments.features:
            np.savez(arguments.features, **made)
    outputs, labels, folds = left_out(made, arguments.seed, arguments.networks), made['labels'], made['folds']
    report('left out', judged(outputs, labels, folds), labels, made['kinds'])
    fit(made['features'], labels, arguments.seed, arguments.networks).calibrated(*platt(outputs, labels)).save(arguments.out)


if __name__ == '__main__':
    main()
