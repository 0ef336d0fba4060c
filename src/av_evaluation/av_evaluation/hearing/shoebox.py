"""Empty shoebox rooms of pyroomacoustics."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from av_common.acoustics import speed_of_sound
from av_evaluation.hearing.signals import RATE


def shoebox(size: NDArray, t60: float, largest_order: int) -> Any:
    """A `pyroomacoustics.ShoeBox` at RATE and 20 degrees Celsius.

    Parameters:
        size (3,): of the room in m.
        t60 (s): reverberation time, which gives the absorption by Sabine's formula.
        largest_order: of reflections.

    Raises ImportError without pyroomacoustics, ValueError for a room that is too large for so short a reverberation.
    """
    import pyroomacoustics
    absorption, order = pyroomacoustics.inverse_sabine(t60, size)
    room = pyroomacoustics.ShoeBox(size, fs=RATE, materials=pyroomacoustics.Material(absorption),
                                   max_order=min(order, largest_order))
    room.set_sound_speed(speed_of_sound(20.0))
    return room
