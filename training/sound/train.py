"""Trains, judges, calibrates and writes the model of drone sounds. See README.md."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rendered
import torch
from judge import report
from material import FOLDS, Recording, esc10, recordings
from numpy.typing import NDArray
from scenes import Scenes, crop
from sklearn.linear_model import LogisticRegression
from torch.nn.functional import binary_cross_entropy_with_logits, pad
from waves import log_uniform

from av_audio.drone_features import LINE_CELLS, LINES, DroneFeatures
from av_audio.drone_model import FUNDAMENTALS, LOWEST_CELL, STEPS, DroneModel, standardised

# Shares of the examples of drones. The lines of an aeroplane are those of many machines: for a likelihood ratio above 1 its
# share must be well above that of one kind of machine. Chosen among 0.2 and 0.28 (model card).
DRONES = {'drone': 0.36, 'rendered drone': 0.36, 'aeroplane drone': 0.28}
# Kinds of others of which there are further examples: combs, and those of the recorder of the drones (FURTHER of all).
OFTEN, FURTHER = ('comb', 'insects', 'helicopter', 'background'), 0.22
RENDERED = {'drone': 1000, 'other': 160, 'comb': 860, 'insects': 860}  # sounds of each kind
SNRS_DB, AS_RECORDED = (-5.0, 35.0), 0.4  # of the examples
# Share of the examples of others that are hardly there: the direction is that of noise which the microphones do not share.
ABSENT, ABSENT_DB = 0.1, (-30.0, -5.0)
# Share of the scenes with a second source; of those, share in which its direction is known; and how much louder than what is
# judged it is at most: beside something else, beside a drone.
BESIDE, SEPARATED = 0.35, 0.6
QUIETER_DB, LOUDER_DB, LOUDER_SEPARATED_DB = -25.0, (-3.0, 3.0), (3.0, 14.0)
EPOCHS, BATCH, LEARNING_RATE, DECAY = 6, 128, 2e-3, 1e-3
# Noise that is added to standardised features, and the share of hidden units that is left out: without, 0.04 fewer of others'
# recordings are found (docs/decisions.md).
NOISE, LEFT_OUT = 0.3, 0.15


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
        self._often = [kind for kind in OFTEN if kind in kinds]

    def drone(self) -> tuple[NDArray, str]:
        """Sound of a drone, and its kind."""
        kind = str(self._rng.choice(list(DRONES), p=list(DRONES.values())))
        return self._of_kind(kind, *((1.0, 1.0) if kind == 'aeroplane drone' else (0.65, 1.5)))

    def other(self, often: bool = False) -> tuple[NDArray, str]:
        """Sound of something else, and its kind, one of OFTEN if need be."""
        return self._of_kind(str(self._rng.choice(self._often if often else self._others)), 0.8, 1.25)

    def _of_kind(self, kind: str, slowest: float, fastest: float) -> tuple[NDArray, str]:
        items = self._by_kind[kind]
        part = crop(items[int(self._rng.integers(len(items)))].samples, self._rng)
        speed = log_uniform(self._rng, slowest, fastest)  # as something of another size would sound
        places = np.arange(len(part)) * speed
        return np.interp(places % (len(part) - 1), np.arange(len(part)), part), kind


def examples(material: Material, scenes: Scenes, count: int, rng: np.random.Generator) -> dict[str, NDArray]:
    """Random scenes: `features` (count, n), `lines` (count, LINES, LINE_CELLS), `labels`, `kinds`, `further` (count,).

    One listens to a drone in half of those that are not further ones, which are of kinds that are OFTEN.

    Parameters:
        material: the sounds.
        scenes: makes scenes of sounds.
        count: number of scenes.
        rng: source of random numbers.
    """
    made: dict[str, list] = {name: [] for name in ('features', 'lines', 'labels', 'kinds', 'further')}
    for number in range(count):
        further = number >= (1.0 - FURTHER) * count
        is_drone = number % 2 == 0 and not further
        source, kind = material.drone() if is_drone else material.other(further)
        other, separated, snr_db = None, bool(rng.random() < SEPARATED), rng.uniform(*SNRS_DB)
        if rng.random() < BESIDE:
            other = material.drone()[0] if not is_drone and rng.random() < 0.5 else material.other()[0]
        elif not is_drone and not further and rng.random() < ABSENT:
            snr_db, kind = rng.uniform(*ABSENT_DB), 'nothing'
        louder_db = (LOUDER_SEPARATED_DB if separated else LOUDER_DB)[is_drone]
        features, lines = scenes.example(source, other, snr_db, rng.uniform(QUIETER_DB, louder_db), separated)
        for name, value in (('features', features), ('lines', lines.astype(np.float16)), ('labels', is_drone), ('kinds', kind),
                            ('further', further)):
            made[name].append(value)
    return {name: np.array(values) for name, values in made.items()}


class Network(torch.nn.Module):
    """A network of `DroneModel`, whose layers have its names."""

    def __init__(self) -> None:
        super().__init__()
        self.lines = torch.nn.Conv1d(LINES, 8, 7, padding=3)
        self.orders = torch.nn.Conv1d(8 * len(STEPS), 24, 1)
        self.fundamentals = torch.nn.Conv1d(24, 24, 5)
        self.hidden, self.output = torch.nn.Linear(2 * 24 + DroneFeatures.COUNT, 48), torch.nn.Linear(48, 1)
        self.left_out = torch.nn.Dropout(LEFT_OUT)

    def forward(self, features: torch.Tensor, lines: torch.Tensor) -> torch.Tensor:
        """Outputs (k,) for standardised features (k, n) and lines (k, LINES, LINE_CELLS)."""
        values = pad(torch.relu(self.lines(lines)), (-LOWEST_CELL, STEPS[-1] + FUNDAMENTALS + LOWEST_CELL - LINE_CELLS))
        values = torch.cat([values[:, :, step:step + FUNDAMENTALS] for step in STEPS], 1)
        values = torch.relu(self.fundamentals(torch.relu(self.orders(values))))
        values = torch.cat([values.amax(2), values.mean(2), features], 1)
        return self.output(self.left_out(torch.relu(self.hidden(values))))[:, 0]

    def layers(self) -> list[tuple[NDArray, NDArray]]:
        """Weights (n, m) and biases (m,) of the layers; n counts the cells of a channel, then the channels."""
        return [(layer.weight.detach().numpy().reshape(len(layer.bias), -1).T, layer.bias.detach().numpy())
                for layer in (self.lines, self.orders, self.fundamentals, self.hidden, self.output)]


def weights_of(labels: NDArray, kinds: NDArray) -> NDArray[np.float32]:
    """Weights (n,) of examples: alike for drones and others, also of those from the recorder of the drones.

    Otherwise the sound of the recorder would speak for a drone.
    """
    weights, recorded = np.ones(len(labels)), np.isin(kinds, ('helicopter', 'background'))
    weights[labels] = np.sum(~labels) / np.sum(labels)
    weights[recorded] = np.sum(weights[kinds == 'drone']) / np.sum(recorded)
    weights[~labels] *= np.sum(weights[labels]) / np.sum(weights[~labels])
    return np.asarray(weights / weights.mean(), np.float32)


def fit(made: dict[str, NDArray], used: NDArray, seed: int, networks: int) -> DroneModel:
    """A model without calibration.

    Parameters:
        made: examples.
        used (n,): whether each is trained on.
        seed: of the first network.
        networks: whose mean is taken.
    """
    features, lines = made['features'][used], made['lines'][used]
    fitted, mean, scale = list[list[tuple[NDArray, NDArray]]](), features.mean(axis=0), features.std(axis=0) + 1e-3
    values = torch.from_numpy(standardised(features, mean, scale).astype(np.float32))
    labels = torch.from_numpy(made['labels'][used].astype(np.float32))
    weights = torch.from_numpy(weights_of(made['labels'][used], made['kinds'][used]))
    for number in range(networks):
        torch.manual_seed(seed + number)
        network, batches = Network(), len(lines) // BATCH
        optimiser = torch.optim.AdamW(network.parameters(), LEARNING_RATE, weight_decay=DECAY)
        rate = torch.optim.lr_scheduler.OneCycleLR(optimiser, LEARNING_RATE, EPOCHS * batches, pct_start=0.15)
        for _ in range(EPOCHS):
            for part in torch.randperm(len(lines))[:batches * BATCH].split(BATCH):
                noisy = values[part] + NOISE * torch.randn(values[part].shape)
                output = network(noisy, torch.from_numpy(lines[part.numpy()].astype(np.float32)))
                optimiser.zero_grad()
                binary_cross_entropy_with_logits(output, labels[part], weights[part]).backward()
                optimiser.step()
                rate.step()
        fitted.append(network.layers())
    return DroneModel(fitted, mean, scale)


def platt(outputs: NDArray, labels: NDArray) -> tuple[float, float]:
    """Slope and offset that make outputs (n,) log-odds (Platt, 1999), for equal shares of drones and others."""
    fitted = LogisticRegression(class_weight='balanced').fit(outputs[:, None], labels)
    return float(fitted.coef_[0, 0]), float(fitted.intercept_[0])


def left_out(made: dict[str, NDArray], seed: int) -> NDArray:
    """Outputs (n,) of models of one network that know neither the kinds of others nor the drones of the fold."""
    outputs = np.zeros(len(made['labels']))
    for fold in range(1, FOLDS + 1):
        model, own = fit(made, made['folds'] != fold, seed, 1), np.flatnonzero(made['folds'] == fold)
        outputs[own] = [model.log_odds(made['features'][k], made['lines'][k].astype(np.float32)) for k in own]
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
    """`examples` of all folds, and their `folds`; all sounds of a scene are of one, which can be left out.

    Parameters:
        items: recordings of all folds.
        count: number of seconds of sound.
        rng: source of random numbers.
    """
    parts, scenes = [], Scenes(rng, AS_RECORDED)
    for fold in range(1, FOLDS + 1):
        material = Material([item for item in items if item.fold == fold], rng)
        made = examples(material, scenes, count // FOLDS, rng)
        parts.append(made | {'folds': np.full(len(made['labels']), fold)})
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('out', type=Path, help='the model, such as ../../src/av_audio/models/drone_sound.npz')
    parser.add_argument('--clips', type=Path, required=True, help="folder of Svanstrom's clips of sound")
    parser.add_argument('--esc', type=Path, required=True, help='folder `audio` of ESC-50, of which ESC-10 is used')
    parser.add_argument('--count', type=int, default=108_000, help='number of examples')
    parser.add_argument('--networks', type=int, default=3, help='networks whose mean is taken')
    parser.add_argument('--features', type=Path, help='file that keeps the examples between runs')
    parser.add_argument('--seed', type=int, default=0)
    arguments = parser.parse_args()
    if arguments.features and arguments.features.exists():
        with np.load(arguments.features) as file:
            made = {name: file[name] for name in file.files}
    else:
        rng = np.random.default_rng(arguments.seed)
        items = [*recordings(arguments.clips), *esc10(arguments.esc), *rendered.recordings(rng, RENDERED)]
        made = examples_of_folds(items, arguments.count, rng)
        if arguments.features:
            np.savez(arguments.features, **made)
    alike = ~made['further']  # all kinds of others are alike often
    outputs, labels = left_out(made, arguments.seed)[alike], made['labels'][alike]
    report('left out', judged(outputs, labels, made['folds'][alike]), labels, made['kinds'][alike])
    everything = np.ones(len(alike), bool)
    fit(made, everything, arguments.seed, arguments.networks).calibrated(*platt(outputs, labels)).save(arguments.out)


if __name__ == '__main__':
    main()
