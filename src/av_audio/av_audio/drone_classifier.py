"""How likely the sound from each direction is that of a drone, and its fundamental."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_audio.drone_features import FUNDAMENTAL_SIGMA, HIGHEST_HZ, DroneFeatures, Segment
from av_audio.drone_model import DroneModel
from av_audio.ego_noise import NoiseRecording
from av_audio.source_spectra import SourceSpectra
from av_common.microphone_array import MicrophoneArray
from av_common.shipped import shipped_file

PERIOD_S = 0.25  # between two looks at the same direction
# Looks at directions closer than this (in q, a cosine) are at one source; its log-odds are averaged over this time.
SAME_SOURCE, MEMORY_S = 0.12, 5.0
LARGEST_LOG_ODDS = 7.0  # no model is surer than its training data
# Sources closer than this (in q) may have passed each other: what is known of them is exchanged where their log-odds then
# differ less from those of the newest looks, by this much in all.
CROSSING, CLEARLY = 0.4, 3.0


@dataclass(eq=False)
class _Source:
    """A direction that was judged: its q, mean log-odds and their weight, fundamental (Hz), and when (s) it was judged last."""

    q: NDArray
    log_odds: float
    weight: float
    time: float
    fundamental: float = math.nan


class _Look(NamedTuple):
    """Log-odds and fundamental (Hz) of a second of the sound from a direction."""

    log_odds: float
    fundamental: float


class Judgement(NamedTuple):
    """What is known of the sound from a direction.

    Parameters:
        probability: that it is a drone's, if drones were as frequent as all else; NaN while unknown.
        fundamental (Hz), variance (Hz^2): of its harmonics; NaN where none stand out.
    """

    probability: float = math.nan
    fundamental: float = math.nan
    variance: float = math.nan


class DroneClassifier:
    """Judges the sound from directions over the last seconds.

    Parameters:
        array: positions of the microphones.
        sample_rate (Hz): sample rate; below twice the highest frequency of the features nothing is judged.
        speed_of_sound (m/s): speed of sound.
        model: see `DroneModel`.
        ego_noise: recording of the rig alone, whose noise is subtracted; None subtracts nothing.
    """

    def __init__(self, array: MicrophoneArray, sample_rate: int, speed_of_sound: float, model: DroneModel,
                 ego_noise: NoiseRecording | None = None) -> None:
        self._model, self._features = model, DroneFeatures()
        self.usable = sample_rate >= 2.0 * HIGHEST_HZ
        self._spectra = SourceSpectra(array, sample_rate, speed_of_sound, ego_noise) if self.usable else None
        self._sources: list[_Source] = []

    def clear(self) -> None:
        """Discard samples and judgements, after a gap."""
        if self._spectra is not None:
            self._spectra.clear()
        self._sources.clear()

    def add(self, samples: NDArray[np.float32]) -> None:
        """Take the next samples (n, m) of the stream, full scale 1."""
        if self._spectra is not None:
            self._spectra.add(samples)

    def judge(self, time: float, directions: Sequence[NDArray], blade_pass_hz: NDArray | None = None) -> list[Judgement]:
        """What is known of the sound from each direction; those of the other directions are separated from it.

        Parameters:
            time (s): time of the newest sample.
            directions: measured projections q (rank,) of the directions on the array's basis, of different sources.
            blade_pass_hz (r,) (Hz): blade-pass frequencies of the rig's own rotors.
        """
        if self._spectra is None or not self._spectra.is_full:
            return [Judgement()] * len(directions)
        self._sources = [source for source in self._sources if 0.0 <= time - source.time <= MEMORY_S]
        known = self._known(directions)
        due = {k for k, source in enumerate(known) if time - source.time >= PERIOD_S or source.weight == 0.0}
        due |= {k for k in range(len(known)) if any(_apart(directions[k], directions[j]) < CROSSING for j in due)}
        looks = {k: self._look(self._spectra.steered(directions[k], blade_pass_hz, [*directions[:k], *directions[k + 1:]]))
                 for k in due}
        _exchange(known, looks, directions)
        for k, look in looks.items():
            _learn(known[k], time, look)
        for source, q in zip(known, directions, strict=True):
            source.q = q
        return [_judgement(source) for source in known]

    def _look(self, segment: Segment) -> _Look:
        odds = float(self._model.log_odds(self._features(segment)))
        return _Look(min(max(odds, -LARGEST_LOG_ODDS), LARGEST_LOG_ODDS), self._features.fundamental(segment))

    def _known(self, directions: Sequence[NDArray]) -> list[_Source]:
        """The source in each direction, the nearest pairs first; one that is in no direction yet begins."""
        free, sources = list(self._sources), dict[int, _Source]()
        while free and len(sources) < len(directions):
            apart, k, source = min(((_apart(source.q, directions[k]), k, source) for source in free
                                    for k in range(len(directions)) if k not in sources), key=lambda pair: pair[0])
            if apart > SAME_SOURCE:
                break
            sources[k] = source
            free.remove(source)
        for k in set(range(len(directions))) - set(sources):
            sources[k] = _Source(directions[k], 0.0, 0.0, -math.inf)
            self._sources.append(sources[k])
        return [sources[k] for k in range(len(directions))]


def load_model(name: str) -> DroneModel | None:
    """The model of a file, or that which ships with the package for an empty name; None for `none`.

    Raises OSError or ValueError for a file that is no model.
    """
    return None if name == 'none' else DroneModel.load(name or shipped_file('av_audio', 'models', 'drone_sound.npz'))


def _learn(source: _Source, time: float, look: _Look) -> None:
    """Add a look at `time` (s) to what is known of a source."""
    kept = source.weight * math.exp(-(time - source.time) / MEMORY_S) if source.weight else 0.0
    source.log_odds = (kept * source.log_odds + look.log_odds) / (kept + 1.0)
    source.weight, source.time, source.fundamental = kept + 1.0, time, look.fundamental


def _exchange(known: list[_Source], looks: Mapping[int, _Look], directions: Sequence[NDArray]) -> None:
    """Exchange what is known of two sources that may have passed each other, where the newest looks at both say so."""
    for a, b in combinations(sorted(looks), 2):
        first, second = known[a], known[b]
        if first.weight and second.weight and _apart(directions[a], directions[b]) < CROSSING:
            kept = abs(looks[a].log_odds - first.log_odds) + abs(looks[b].log_odds - second.log_odds)
            exchanged = abs(looks[a].log_odds - second.log_odds) + abs(looks[b].log_odds - first.log_odds)
            if kept > exchanged + CLEARLY:
                known[a], known[b] = second, first


def _judgement(source: _Source) -> Judgement:
    variance = (FUNDAMENTAL_SIGMA * source.fundamental) ** 2
    return Judgement(1.0 / (1.0 + math.exp(-source.log_odds)), source.fundamental, variance)


def _apart(first: NDArray, second: NDArray) -> float:
    return float(np.linalg.norm(first - second))
