"""Which turn of the rig would best tell front from back.

The true source stays where it is in the world while its mirror image moves by twice the turn; how soon that shows depends
on how sharply the array hears in the new direction, and on whether the camera comes to see one of the two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from av_common.angles import wrap


@dataclass(frozen=True)
class RotationSettings:
    """Bounds of the manoeuvre (rad, rad/s, s).

    The rig waits `patience` before it asks for a turn, turns at about `rate`, by at most `largest`, and stays within
    `sector` to both sides of where it first asked. A non-zero `fixed` asks for that turn always, as published.
    `broadside_sigma` is the error of hearing at broadside, `needed_information` the nats that decide.
    """

    enabled: bool = True
    patience: float = 0.6
    rate: float = math.radians(40.0)
    largest: float = math.radians(90.0)
    sector: float = math.pi
    fixed: float = 0.0
    broadside_sigma: float = math.radians(2.0)
    half_view: float = math.radians(35.0)
    needed_information: float = 4.6


class RotationPlanner:
    """Asks for a turn when modes stay balanced, holds it until it is made, and asks again if it did not help."""

    def __init__(self, settings: RotationSettings | None = None) -> None:
        self.settings = settings or RotationSettings()
        self._since: float | None = None
        self._target: float | None = None
        self._centre: float | None = None

    def cancel(self) -> None:
        """The question is settled."""
        self._since = self._target = None

    def plan(self, time: float, yaw: float, modes: Sequence[tuple[float, float, float]], axis: float,
             visibility: float) -> float:
        """The turn (rad, counter-clockwise) still to be made at `time`, 0 when none is asked for.

        `modes` are (azimuth in the body frame, variance, weight), `axis` is the array's end-fire in the body frame, `yaw`
        the rig's in the world.
        """
        if not self.settings.enabled or len(modes) < 2:
            self.cancel()
            return 0.0
        self._since = time if self._since is None else self._since
        if time - self._since < self.settings.patience:
            return 0.0
        if self._target is not None:
            remaining = float(wrap(self._target - yaw))
            if abs(remaining) > math.radians(2.0):
                return remaining
            self.cancel()  # made, and nothing decided: listen for a while, then ask anew
            return 0.0
        self._centre = yaw if self._centre is None else self._centre
        turn = self._choose(yaw, modes, axis, visibility if math.isfinite(visibility) else 0.0)
        self._target = float(wrap(yaw + turn)) if turn else None
        return turn

    def _choose(self, yaw: float, modes: Sequence[tuple[float, float, float]], axis: float, visibility: float) -> float:
        settings = self.settings
        sizes = np.radians(np.arange(10.0, math.degrees(settings.largest) + 1e-6, 5.0))
        turns = np.array([settings.fixed]) if settings.fixed else np.concatenate([sizes, -sizes])
        offset = float(wrap(yaw - (self._centre or 0.0)))
        turns = turns[np.abs(offset + turns) <= settings.sector]
        if not turns.size:
            return 0.0
        first, second = sorted(modes, key=lambda mode: -mode[2])[:2]
        total = first[2] + second[2]
        information = sum(true[2] / total * expected_information(turns, true, false, axis, visibility, settings)
                          for true, false in ((first, second), (second, first)))
        duration = np.abs(turns) / settings.rate
        enough = information >= settings.needed_information
        best = np.argmin(np.where(enough, duration, np.inf)) if enough.any() else np.argmax(information)
        return float(turns[best])


def expected_information(turns: np.ndarray, true: tuple[float, float, float], false: tuple[float, float, float],
                         axis: float, visibility: float, settings: RotationSettings) -> np.ndarray:
    """Nats by which a turn (n,) is expected to favour the true mode over its mirror image, were `true` the true one.

    Hearing: squared distance of the false mode from the nearest of the two directions heard after the turn, over twice its
    variance, which grows as 1/sin^2 towards end-fire. Sight: the logarithm of the odds of a detection where one of them
    comes into view.
    """
    after = wrap(true[0] - turns)
    stale = wrap(false[0] - turns)
    distance = np.minimum(np.abs(wrap(stale - after)), np.abs(wrap(stale - (2.0 * axis - after))))
    sharpness = np.maximum(np.sin(after - axis) ** 2, 0.02)
    heard = distance**2 / (2.0 * (settings.broadside_sigma**2 / sharpness + false[1]))
    in_view = (np.abs(after) < settings.half_view) | (np.abs(stale) < settings.half_view)
    return np.minimum(heard, 10.0) + np.where(in_view, 4.0 * visibility, 0.0)
