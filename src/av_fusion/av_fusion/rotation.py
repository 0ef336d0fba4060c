"""Which turn of the rig would soonest tell front from back.

The true source stays where it is in the world while its mirror image moves by twice the turn; how soon that shows depends
on how sharply the array hears in the new direction, and on whether the camera comes to see one of the two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap

HORIZON = np.arange(0.1, 6.05, 0.1)  # s ahead, in which a decision is looked for


@dataclass(frozen=True)
class RotationSettings:
    """Bounds of the manoeuvre (rad, rad/s, s).

    The rig waits `patience` before it asks for a turn, turns at about `rate`, by at most `largest`, and stays within
    `sector` to both sides of where it first asked. A non-zero `fixed` asks for that turn always, as published.
    `broadside_sigma` is the error of hearing at broadside over one `window`, `needed_information` the nats that decide.
    """

    enabled: bool = True
    patience: float = 0.6
    rate: float = math.radians(40.0)
    largest: float = math.radians(90.0)
    sector: float = math.pi
    fixed: float = 0.0
    broadside_sigma: float = math.radians(2.0)
    window: float = 0.5
    half_view: float = math.radians(35.0)
    needed_information: float = 5.0


@dataclass(frozen=True)
class Image:
    """Where the target may be: body azimuth (rad) and its variance, variance of its rate (rad^2/s^2), and weight."""

    azimuth: float
    variance: float
    rate_variance: float
    weight: float


class RotationPlanner:
    """Asks for a turn when images stay balanced, holds it until it is made, and asks again if it did not help."""

    def __init__(self, settings: RotationSettings | None = None) -> None:
        self.settings = settings or RotationSettings()
        self._since: float | None = None
        self._target: float | None = None
        self._centre: float | None = None

    def cancel(self) -> None:
        """The question is settled."""
        self._since = self._target = None

    def plan(self, time: float, yaw: float, images: Sequence[Image], axis: float, visibility: float) -> float:
        """The turn (rad, counter-clockwise) still to be made at `time`, 0 when none is asked for.

        `axis` is the array's end-fire in the body frame, `yaw` the rig's in the world.
        """
        if not self.settings.enabled or len(images) < 2:
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
        turn = self._choose(yaw, images, axis, visibility if math.isfinite(visibility) else 0.0)
        self._target = float(wrap(yaw + turn)) if turn else None
        return turn

    def _choose(self, yaw: float, images: Sequence[Image], axis: float, visibility: float) -> float:
        settings = self.settings
        sizes = np.radians(np.arange(15.0, math.degrees(settings.largest) + 1e-6, 15.0))
        turns = np.array([settings.fixed]) if settings.fixed else np.concatenate([sizes, -sizes])
        offset = float(wrap(yaw - (self._centre or 0.0)))
        turns = turns[np.abs(offset + turns) <= settings.sector]
        if not turns.size:
            return 0.0
        first, second = sorted(images, key=lambda image: -image.weight)[:2]
        total = first.weight + second.weight
        expected = sum(true.weight / total * time_to_decide(turns, true, false, axis, visibility, settings)
                       for true, false in ((first, second), (second, first)))
        return float(turns[np.argmin(expected)])


def time_to_decide(turns: NDArray, true: Image, false: Image, axis: float, visibility: float,
                   settings: RotationSettings) -> NDArray[np.float64]:
    """Seconds until each of the turns (n,) is expected to have told the true image from the false one, were `true` true.

    Evidence of hearing gathers at d^2/(2 s^2) nats a window: d is how far the false image has moved off both directions
    heard, s^2 its own variance, what its unknown rate explains, and the array's error, which grows as 1/sin^2 towards
    end-fire. Evidence of sight comes at once where one of the two enters the view. A turn that decides nothing within the
    horizon costs more the less it tells.
    """
    turned = np.sign(turns)[:, None] * np.minimum(np.abs(turns)[:, None], settings.rate * HORIZON)
    after, stale = wrap(true.azimuth - turned), wrap(false.azimuth - turned)
    distance = np.minimum(np.abs(wrap(stale - after)), np.abs(wrap(stale - (2.0 * axis - after))))
    sharpness = np.maximum(np.sin(after - axis) ** 2, 0.02)
    variance = settings.broadside_sigma**2 / sharpness + false.variance + false.rate_variance * HORIZON**2
    heard = np.cumsum(np.minimum(distance**2 / (2.0 * variance), 10.0), axis=1) * (HORIZON[1] - HORIZON[0]) / settings.window
    in_view = (np.abs(after) < settings.half_view) | (np.abs(stale) < settings.half_view)
    information = heard + np.where(np.logical_or.accumulate(in_view, axis=1), 6.0 * visibility, 0.0)
    decided = information >= settings.needed_information
    undecided = HORIZON[-1] + settings.needed_information - information[:, -1]
    return np.where(decided.any(axis=1), HORIZON[np.argmax(decided, axis=1)], undecided)
