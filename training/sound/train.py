"""Trains, calibrates and writes the model of drone sounds. See README.md."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rendered
import simulated
from material import FOLDS, KNOWN, Recording, recordings
from numpy.typing import NDArray
from scenes import Scenes, crop
from sklearn.linear_model import LogisticRegression
from sklearn.neural_network import MLPClassifier

from av_audio.drone_model import LARGEST_FEATURE, DroneModel

RENDERED_SHARES = (0.5, 0.25)  # of the examples of drones and of others, in the fold that has rendered sounds
OTHER_FOLDS = 0.32  # share of all examples that is from the recordings that are judged on
LOUD, OFTEN = ('alarm', 'rendered alarm', 'rendered bystander'), 3  # kinds that are drawn as many times as often as others
HIDDEN = (32, 16)
RENDERED = (500, 500)  # sounds of drones and of others
SNRS_DB, AS_RECORDED = (-3.0, 35.0), 0.4  # of the examples
# Share of the scenes with a second source; of those, share in which its direction is known; and how much louder than what is
# judged it is at most: beside something else, beside a drone.
BESIDE, SEPARATED = 0.35, 0.6
QUIETER_DB, LOUDER_DB, LOUDER_SEPARATED_DB = -25.0, (-3.0, 3.0), (3.0, 14.0)
EPOCHS = 15
CALIBRATION_FOLDS = 4  # of recordings
RIG_COUNT = 2  # how often an example that the rig heard in simulated scenes counts


class Material:
    """Draws sounds: a drone, or one of the other kinds, alike often but for loud ones.

    Parameters:
        items: recordings of one fold.
        rng: source of random numbers.
        rendered: shares of rendered sounds among those of drones and of others.
    """

    def __init__(self, items: Sequence[Recording], rng: np.random.Generator, rendered: tuple[float, float] = (0.0, 0.0)
                 ) -> None:
        self._rng, self._rendered = rng, rendered
        self._by_kind: dict[str, dict[str, list[Recording]]] = {}
        for item in items:
            self._by_kind.setdefault(item.kind, {}).setdefault(item.group, []).append(item)
        self._kinds = sorted(kind for kind in self._by_kind if not kind.endswith('drone'))

    def drone(self) -> tuple[NDArray, str]:
        """Sound of a drone and the group of recordings that it comes from."""
        return self._of_kind('rendered drone' if self._rng.random() < self._rendered[0] else 'drone', 0.65, 1.5)

    def other(self) -> tuple[NDArray, str]:
        """Sound of something else, and its group."""
        is_rendered = self._rng.random() < self._rendered[1]
        kinds = [kind for kind in self._kinds if kind.startswith('rendered') == is_rendered]
        kinds += (OFTEN - 1) * [kind for kind in kinds if kind in LOUD]
        return self._of_kind(str(self._rng.choice(kinds)), 0.8, 1.25)

    def _of_kind(self, kind: str, slowest: float, fastest: float) -> tuple[NDArray, str]:
        groups = self._by_kind[kind]
        group = str(self._rng.choice(sorted(groups)))
        samples = groups[group][int(self._rng.integers(len(groups[group])))].samples
        speed = np.exp(self._rng.uniform(np.log(slowest), np.log(fastest)))
        part = crop(samples, self._rng)
        places = np.arange(len(part)) * speed  # played faster or slower, as something of another size would sound
        return np.interp(places % (len(part) - 1), np.arange(len(part)), part), group


def examples(material: Material, scenes: Scenes, count: int, rng: np.random.Generator) -> tuple[NDArray, NDArray, NDArray]:
    """Features (count, n), labels (count,) and groups (count,) of random scenes; in half of them one listens to a drone.

    Parameters:
        material: the sounds.
        scenes: makes scenes of sounds.
        count: number of scenes.
        rng: source of random numbers.
    """
    features, labels, groups = [], [], []
    for number in range(count):
        is_drone = number % 2 == 0
        source, group = material.drone() if is_drone else material.other()
        other, separated = None, bool(rng.random() < SEPARATED)
        if rng.random() < BESIDE:
            other = material.drone()[0] if not is_drone and rng.random() < 0.5 else material.other()[0]
        louder_db = (LOUDER_SEPARATED_DB if separated else LOUDER_DB)[is_drone]
        features.append(scenes.example(source, other, rng.uniform(*SNRS_DB), rng.uniform(QUIETER_DB, louder_db), separated))
        labels.append(is_drone)
        groups.append(group)
    return np.array(features), np.array(labels), np.array(groups)


def fit(features: NDArray, labels: NDArray, seed: int, networks: int = 1) -> DroneModel:
    """A model without calibration. Several networks are joined into one, whose output is their mean."""
    mean, scale = features.mean(axis=0), features.std(axis=0) + 1e-3
    values = np.clip((features - mean) / scale, -LARGEST_FEATURE, LARGEST_FEATURE)
    fitted = [MLPClassifier(HIDDEN, alpha=5.0, batch_size=256, learning_rate_init=1e-3, max_iter=EPOCHS,
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


def calibrated(features: NDArray, labels: NDArray, groups: NDArray, seed: int, networks: int) -> DroneModel:
    """The model fitted to all, calibrated by the outputs of models that did not know the recording (Platt, 1999)."""
    names = np.unique(groups)
    fold_of = dict(zip(names, np.random.default_rng(seed).permutation(len(names)) % CALIBRATION_FOLDS, strict=True))
    folds = np.array([fold_of[group] for group in groups])
    outputs = np.zeros(len(labels))
    for fold in range(CALIBRATION_FOLDS):
        outputs[folds == fold] = fit(features[folds != fold], labels[folds != fold], seed).log_odds(features[folds == fold])
    platt = LogisticRegression().fit(outputs[:, None], labels)
    model = fit(features, labels, seed, networks)
    return model.calibrated(float(platt.coef_[0, 0]), float(platt.intercept_[0]))


def examples_of_folds(items: Sequence[Recording], count: int, scenes: int, rng: np.random.Generator) -> dict[str, NDArray]:
    """Features (m, n), labels, groups and folds (m,); all sounds of a scene are of one fold, which can be left out.

    Parameters:
        items: recordings of KNOWN and of all folds.
        count: number of seconds of sound.
        scenes: number of simulated scenes, each with some 70 further examples.
        rng: source of random numbers.
    """
    parts = []
    for fold in (KNOWN, *range(1, FOLDS + 1)):
        share, shares = (1.0 - OTHER_FOLDS, RENDERED_SHARES) if fold == KNOWN else (OTHER_FOLDS / FOLDS, (0.0, 0.0))
        material = Material([item for item in items if item.fold == fold], rng, shares)
        made = examples(material, Scenes(rng, AS_RECORDED), round(share * count), rng)
        parts.append((*made, np.full(len(made[1]), fold)))
    if scenes:
        recorded = [item for item in items if item.fold == KNOWN and not item.kind.startswith('rendered')]
        made = simulated.examples(recorded, scenes, rng)
        parts += RIG_COUNT * [(*made, np.full(len(made[1]), KNOWN))]
    return dict(zip(('features', 'labels', 'groups', 'folds'), map(np.concatenate, zip(*parts, strict=True)), strict=True))


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('out', type=Path, help='the model, such as ../../src/av_audio/models/drone_sound.npz')
    parser.add_argument('--clips', type=Path, required=True, help="folder of Svanstrom's clips of sound")
    parser.add_argument('--packages', type=Path, required=True, help='folder for the sounds of Debian packages')
    parser.add_argument('--repository', type=Path, help='git directory of the repository that material.py names')
    parser.add_argument('--folds', type=Path, help='folder for models that do not know one fold each, by which it is judged')
    parser.add_argument('--count', type=int, default=36_000, help='number of examples')
    parser.add_argument('--scenes', type=int, default=100, help='number of simulated scenes that the rig hears')
    parser.add_argument('--networks', type=int, default=5, help='networks whose mean is taken')
    parser.add_argument('--features', type=Path, help='file that keeps the examples between runs')
    parser.add_argument('--seed', type=int, default=0)
    arguments = parser.parse_args()
    if arguments.features and arguments.features.exists():
        with np.load(arguments.features) as file:
            made = {name: file[name] for name in file.files}
    else:
        rng = np.random.default_rng(arguments.seed)
        items = list(recordings(arguments.clips, arguments.packages, arguments.repository))
        made = examples_of_folds([*items, *rendered.recordings(rng, *RENDERED)], arguments.count, arguments.scenes, rng)
        if arguments.features:
            np.savez(arguments.features, **made)
    for fold in range(1, FOLDS + 1) if arguments.folds else ():
        arguments.folds.mkdir(parents=True, exist_ok=True)
        kept = [made[name][made['folds'] != fold] for name in ('features', 'labels', 'groups')]
        calibrated(*kept, arguments.seed, arguments.networks).save(arguments.folds / f'fold_{fold}.npz')
    calibrated(made['features'], made['labels'], made['groups'], arguments.seed, arguments.networks).save(arguments.out)


if __name__ == '__main__':
    main()
