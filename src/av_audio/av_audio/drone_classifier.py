"""How likely the sound from each direction of a window is that of a drone, and its fundamental."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from numpy.typing import NDArray

from av_audio.drone_features import FUNDAMENTAL_SIGMA, DroneFeatures
from av_audio.drone_model import DroneModel
from av_audio.ego_noise import NoiseRecording
from av_audio.source_spectra import SourceSpectra
from av_common.microphone_array import MicrophoneArray
from av_common.shipped import shipped_file


class Judgement(NamedTuple):
    """What the newest second of the sound from a direction says, by itself.

    Parameters:
        probability: that it is a drone's, if drones were as frequent as all else: the sigmoid of the logarithm of the ratio of
            the likelihoods of drones and of all else. NaN while unknown.
        fundamental (Hz), variance (Hz^2): of its harmonics; NaN where none stand out.
    """

    probability: float = math.nan
    fundamental: float = math.nan
    variance: float = math.nan


class DroneClassifier(SourceSpectra):
    """Judges the newest second of sound from directions. What former windows said is forgotten.

    Parameters:
        array, sample_rate, speed_of_sound, ego_noise: see `SourceSpectra`.
        model: see `DroneModel`.
    """

    def __init__(self, array: MicrophoneArray, sample_rate: int, speed_of_sound: float, model: DroneModel,
                 ego_noise: NoiseRecording | None = None) -> None:
        super().__init__(array, sample_rate, speed_of_sound, ego_noise)
        self._model, self._features = model, DroneFeatures()

    def judge(self, directions: Sequence[NDArray], blade_pass_hz: NDArray | None = None) -> list[Judgement]:
        """What is known of the sound from each direction; those of the other directions are separated from it.

        Parameters:
            directions: measured projections q (rank,) of the directions on the array's basis, of different sources.
            blade_pass_hz (r,) (Hz): blade-pass frequencies of the rig's own rotors.
        """
        if not self.is_full:
            return [Judgement()] * len(directions)
        judged = []
        for segment in self.steered(directions, blade_pass_hz):
            probability = 1.0 / (1.0 + math.exp(-self._model.log_odds(self._features(segment), self._features.lines(segment))))
            fundamental = self._features.fundamental(segment)
            judged.append(Judgement(probability, fundamental, (FUNDAMENTAL_SIGMA * fundamental) ** 2))
        return judged


def load_model(name: str) -> DroneModel | None:
    """The model of a file, or that which ships with the package for an empty name; None for `none`.

    Raises OSError or ValueError for a file that is no model.
    """
    return None if name == 'none' else DroneModel.load(name or shipped_file('av_audio', 'models', 'drone_sound.npz'))
