"""Recordings that are trained on: Svanstrom's clips (CC0 1.0), mono, with their folds. Nothing of them is committed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile
from numpy.typing import NDArray
from scipy.signal import resample_poly

RATE = 16_000  # Hz, of everything that is trained on
KINDS = {'DRONE': 'drone', 'HELICOPTER': 'helicopter', 'BACKGROUND': 'background'}
FOLDS = 5  # each is judged by a model that knows the others
EVERYWHERE = 0  # in place of a fold: what every model knows, and none is judged on
BLOCK = 3  # clips whose numbers follow each other may be of one place: they are in one fold


@dataclass(frozen=True)
class Recording:
    """One recording: its kind, its name, its fold (1 to FOLDS), and its mono samples (n,) at RATE."""

    kind: str
    name: str
    fold: int
    samples: NDArray[np.float32]

    @property
    def is_drone(self) -> bool:
        """Whether it is of a drone."""
        return self.kind.endswith('drone')


def recordings(clips: Path) -> Iterator[Recording]:
    """All clips of a folder, all of Svanstrom's or a part (`../shared/data/drone_detection/audio`)."""
    for path in sorted(path for path in clips.iterdir() if path.suffix in ('.flac', '.wav')):
        kind, number = path.stem.split('_')
        samples, rate = soundfile.read(path, always_2d=True, dtype='float32')
        yield Recording(KINDS[kind], path.stem, 1 + int(number) // BLOCK % FOLDS,
                        resample_poly(samples.mean(axis=1), RATE, rate).astype(np.float32))
