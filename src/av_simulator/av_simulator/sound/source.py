"""A thing that sounds."""

from __future__ import annotations

from dataclasses import dataclass

from av_simulator.sound.delays import Position
from av_simulator.sound.directivity import Directivity
from av_simulator.sound.source_signals import SourceSignal


@dataclass(frozen=True)
class Source:
    """A point that emits sound.

    Parameters:
        position: world ENU positions (k, 3) in m at times (k,) in s, before time 0 as well.
        signal: sound pressure at 1 m.
        gain_db (dB): on the signal.
        directivity: gain by direction and frequency, None for all around.
    """

    position: Position
    signal: SourceSignal
    gain_db: float = 0.0
    directivity: Directivity | None = None
