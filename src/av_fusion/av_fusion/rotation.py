"""Which turn of the rig would soonest tell front from back.

The true source stays on its course in the world while its mirror image moves by twice the turn; how soon that shows depends
on the array's direction, on how far either could have moved by itself, and on whether the camera comes to see one of the two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap

HORIZON = np.arange(0.1, 6.05, 0.1)  # s ahead, in which a decision is looked for
MADE = math.radians(2.0)  # a turn is made when less than this is left
SOONER_S = 2.0  # the other way must promise this much before the rig turns back
RETHINK_S = 0.1  # between reckonings
SIGHT_NATS = 6.0  # what a look at one of the images tells in clear air


@dataclass(frozen=True)
class RotationSettings:
    """Bounds of the manoeuvre (rad, rad/s, s).

    The rig waits `patience` before it asks for a turn, turns at about `rate`, and stays within `sector` to both sides of
    where it first asked. A non-zero `fixed` asks for that turn always, as published. `broadside_sigma` is the error of
    hearing at broadside over one `window`; `needed_odds` of the two images decide.
    """

    enabled: bool = True
    patience: float = 0.0
    rate: float = math.radians(40.0)
    sector: float = math.pi
    fixed: float = 0.0
    broadside_sigma: float = math.radians(2.0)
    window: float = 0.5
    half_view: float = math.radians(35.0)
    needed_odds: float = 19.0


@dataclass(frozen=True)
class Image:
    """Where the target may be: body azimuth (rad), its rate in the world (rad/s), their variances, and weight."""

    azimuth: float
    variance: float
    rate: float
    rate_variance: float
    weight: float


class RotationPlanner:
    """Asks for a turn when images stay balanced, and for as long as it tells more."""

    def __init__(self, settings: RotationSettings | None = None) -> None:
        self.settings = settings or RotationSettings()
        self._since: float | None = None
        self._target: float | None = None  # yaw at the end of a fixed turn
        self._direction = 0.0
        self._reckoned = -math.inf
        self._centre: float | None = None

    def cancel(self) -> None:
        """The question is settled."""
        self._since = self._target = self._centre = None
        self._direction = 0.0

    def plan(self, time: float, yaw: float, images: Sequence[Image], axis: float, visibility: float) -> float:
        """The turn (rad, counter-clockwise) still to be made at `time`, 0 when none is asked for.

        `axis` is the array's end-fire in the body frame, `yaw` the rig's in the world.
        """
        settings = self.settings
        if not settings.enabled or len(images) < 2:
            self.cancel()
            return 0.0
        self._since = time if self._since is None else self._since
        if time - self._since < settings.patience:
            return 0.0
        self._centre = yaw if self._centre is None else self._centre
        offset = float(wrap(yaw - self._centre))
        if settings.fixed:
            return self._fixed_turn(yaw, offset)
        left = {direction: settings.sector - direction * offset for direction in (1.0, -1.0)}
        left = {direction: min(room, math.pi / 2.0) for direction, room in left.items() if room > MADE}
        if not left:
            return 0.0
        if self._direction in left and abs(time - self._reckoned) < RETHINK_S:
            return self._direction * left[self._direction]
        self._reckoned = time
        visibility = visibility if math.isfinite(visibility) else 0.0
        first, second = sorted(images, key=lambda image: -image.weight)[:2]
        expected = {direction: expected_time(direction * room, first, second, axis, visibility, settings)
                    - SOONER_S * (direction == self._direction) for direction, room in left.items()}
        self._direction = min(expected, key=expected.get)
        return self._direction * left[self._direction]

    def _fixed_turn(self, yaw: float, offset: float) -> float:
        """The published turn: made once, then the rig listens for `patience` and asks again."""
        if self._target is None:
            if abs(offset + self.settings.fixed) > self.settings.sector:
                return 0.0
            self._target = float(wrap(yaw + self.settings.fixed))
        left = float(wrap(self._target - yaw))
        if abs(left) > MADE:
            return left
        self._since = self._target = None
        return 0.0


def expected_time(turn: float, first: Image, second: Image, axis: float, visibility: float,
                  settings: RotationSettings) -> float:
    """Seconds until a turn (rad) is expected to have decided between two images, over which of them is the true one."""
    total = first.weight + second.weight
    return sum(true.weight / total * time_to_decide(turn, true, false, axis, visibility, settings)
               for true, false in ((first, second), (second, first)))


def time_to_decide(turn: float, true: Image, false: Image, axis: float, visibility: float,
                   settings: RotationSettings) -> float:
    """Seconds until a turn (rad) has told the true image from the false one, were `true` true.

    What is heard is the cosine of the angle from the array's axis. The false image explains it the worse the further its own
    course leads from the true one's, d^2 / (2 s^2) nats; s^2 holds what its unknown rate may make up for, and the array's
    error, averaged over the windows so far. Evidence of sight comes at once where one of the two enters the view. Decided
    is what has the odds, and the true image clear of end-fire, where front and back are one. A turn that decides nothing
    within the horizon costs more the less it tells.
    """
    turned = math.copysign(1.0, turn) * np.minimum(abs(turn), settings.rate * HORIZON)
    after, stale = (wrap(image.azimuth + image.rate * HORIZON - turned) for image in (true, false))
    spread = false.variance + false.rate_variance * HORIZON**2
    unexplained = np.cos(after - axis) - np.cos(stale - axis)
    variance = (np.sin(stale - axis) ** 2 * spread + 0.5 * np.minimum(spread, 1.0) ** 2
                + settings.broadside_sigma**2 * settings.window / HORIZON)
    heard = np.maximum.accumulate(0.5 * unexplained**2 / variance)
    in_view = (np.abs(after) < settings.half_view) | (np.abs(stale) < settings.half_view)
    information = heard + np.where(np.logical_or.accumulate(in_view), SIGHT_NATS * visibility, 0.0)
    needed = math.log(settings.needed_odds) - math.log(max(true.weight, 1e-9) / max(false.weight, 1e-9))
    clear = np.abs(np.sin(after - axis)) > min(2.0 * math.sqrt(true.variance), 0.35)
    return _first((information >= needed) & clear, needed - information[-1])


def _first(decided: NDArray[np.bool_], missing: float) -> float:
    """When it is decided, or how far beyond the horizon."""
    return float(HORIZON[np.argmax(decided)]) if decided.any() else float(HORIZON[-1]) + max(missing, 0.0)
