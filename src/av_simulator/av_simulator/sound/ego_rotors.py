"""Ego-noise: the rig's own rotors near its microphones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from av_common.config_reader import bounded
from av_simulator.sound.delays import AFTER, BEFORE, interpolate
from av_simulator.sound.rotor import RotorSignal
from av_simulator.sound.stream import CHUNK, Stream
from av_simulator.trajectories import Static

HOVERING = Static((0.0, 0.0, 0.0))  # the rotors' speeds do not follow the motion of the rig


@dataclass(frozen=True)
class EgoRotors:
    """The rig's own rotors. The body is rigid, so that distances and delays to the microphones are constant.

    Parameters:
        signal: signal of the whole vehicle.
        rotors (m, (rotors, 3)): positions of the hubs in the body frame.
        microphones (m, (m, 3)): positions of the microphones in the body frame.
    """

    signal: RotorSignal
    rotors: Sequence[Sequence[float]] = bounded(low=-100.0, high=100.0)
    microphones: Sequence[Sequence[float]] = bounded((), low=-100.0, high=100.0)

    def __post_init__(self) -> None:
        if np.shape(self.rotors) != (len(self.signal.rotor_hz), 3):
            raise ValueError(f'ego rotors have shape {np.shape(self.rotors)}, expected ({len(self.signal.rotor_hz)}, 3), '
                             'one position for each speed in rotor_hz')

    def stream(self, sample_rate: int, microphones: int, speed_of_sound: float, key: Sequence[int]) -> Stream:
        """Pressure (Pa, (m, CHUNK)) at the microphones: each rotor with a gain of 1/r, r at least 5 cm.

        Raises ValueError for a wrong number of microphone positions.

        Parameters:
            sample_rate (Hz): sample rate.
            microphones: number of microphones.
            speed_of_sound (m/s): speed of sound.
            key: seed.
        """
        if np.shape(self.microphones) != (microphones, 3):
            raise ValueError(f'ego rotors: microphones have shape {np.shape(self.microphones)}, expected ({microphones}, 3)')
        away = np.asarray(self.rotors, float)[:, None] - np.asarray(self.microphones, float)
        distance = np.maximum(np.linalg.norm(away, axis=-1), 0.05)[..., None]  # (rotors, m, 1)
        signals = [self._signal_of(number).stream(sample_rate, [*key, number], HOVERING) for number in range(len(self.rotors))]
        delay = distance * (sample_rate / speed_of_sound)
        reach = int(delay.max()) + BEFORE + 2
        places = np.arange(CHUNK) + reach - delay
        rows = np.broadcast_to(np.arange(len(signals))[:, None, None], places.shape)

        def make(index: int) -> NDArray:
            turned = [signal.read(index * CHUNK - reach, (index + 1) * CHUNK + AFTER + 2) for signal in signals]
            return (interpolate(np.array(turned), rows, places) / distance).sum(axis=0)

        return Stream(make)

    def _signal_of(self, rotor: int) -> RotorSignal:
        """The signal of one rotor, with its share of the vehicle's power."""
        share_db = 10.0 * np.log10(len(self.rotors))
        return replace(self.signal, rotor_hz=(self.signal.rotor_hz[rotor],),
                       tone_db_spl=self.signal.tone_db_spl - share_db, broadband_db_spl=self.signal.broadband_db_spl - share_db)
