"""Sound sources."""

from __future__ import annotations

from dataclasses import dataclass

from av_simulator.sound.delays import Position
from av_simulator.sound.directivity import Directivity
from av_simulator.sound.source_signals import SourceSignal


@dataclass(frozen=True)
class Source:
    """A point that emits sound.

    Parameters:
        position: trajectory, a function from times (s, (k,)), which may be negative, to positions (m, (k, 3)) in ENU.
        signal: sound pressure at 1 m.
        gain_db (dB): gain of the signal.
        directivity: gain by direction and frequency, None for an omnidirectional source.
    """

    position: Position
    signal: SourceSignal
    gain_db: float = 0.0
    directivity: Directivity | None = None
