"""Recordings that are trained on, mono, with their folds: Svanstrom's clips (CC0), ESC-10 (CC BY 3.0). None is committed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile
from numpy.typing import NDArray
from scipy.signal import resample_poly

RATE = 16_000  # Hz, of everything that is trained on
SPEED_OF_SOUND = 343.0  # m/s
# Classes of ESC-50 that make up ESC-10, by their number in the file's name, with the fold of their family (`others.py`).
ESC10 = {0: ('recorded dog', 5), 1: ('recorded rooster', 5), 10: ('recorded rain', 2), 11: ('recorded surf', 2),
         12: ('recorded fire', 2), 20: ('recorded baby', 5), 21: ('recorded sneeze', 5), 38: ('recorded clock', 5),
         40: ('recorded helicopter', 3), 41: ('recorded chainsaw', 3)}
KINDS = {'DRONE': 'drone', 'HELICOPTER': 'helicopter', 'BACKGROUND': 'background'}
FOLDS = 5  # each is judged by a model that knows the others
BLOCK = 3  # clips whose numbers follow each other may be of one place: they are in one fold


@dataclass(frozen=True)
class Recording:
    """One recording: its kind, its fold (1 to FOLDS), and its mono samples (n,) at RATE."""

    kind: str
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
        yield Recording(KINDS[kind], 1 + int(number) // BLOCK % FOLDS, mono(path))


def esc10(folder: Path) -> Iterator[Recording]:
    """The clips of ESC-10 in the folder `audio` of ESC-50."""
    for path in sorted(folder.glob('*-*-*-*.wav')):
        if (number := int(path.stem.rsplit('-', 1)[1])) in ESC10:
            kind, fold = ESC10[number]
            yield Recording(kind, fold, mono(path))


def mono(path: Path) -> NDArray[np.float32]:
    """Samples (n,) of a file at RATE."""
    samples, rate = soundfile.read(path, always_2d=True, dtype='float32')
    return np.asarray(resample_poly(samples.mean(axis=1), RATE, rate), np.float32)
