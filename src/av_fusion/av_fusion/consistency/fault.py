"""What is told of a rig that is not as described."""

from __future__ import annotations

from typing import NamedTuple


class Fault(NamedTuple):
    """What is wrong with the description of the rig.

    Parameters:
        text: what is wrong, with its value.
        mend: where it is mended.
        probability: that the description is wrong.
        is_certain: nothing should move by the bearing.
    """

    text: str
    mend: str
    probability: float
    is_certain: bool

    def __str__(self) -> str:
        return f'{self.text} (probability {min(self.probability, 0.9999):.4f}): {self.mend}'
