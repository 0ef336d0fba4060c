"""Which turn of the rig would soonest tell front from back.

The true source stays on its course in the world while its mirror image moves by twice the turn; how soon that shows depends
on the array's direction, on how far either could have moved by itself, and on whether the camera comes to see one of the two.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap

HORIZON = np.arange(0.2, 6.1, 0.2)  # s ahead, in which a decision is looked for
MADE = math.radians(2.0)  # a turn is made when less than this is left
SOONER_S = 2.0  # the other way must promise this much before the rig turns back
RETHINK_S = 0.2  # between reckonings
ANEW_S = 5.0  # after so long a question is a new one
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


class Image(NamedTuple):
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
        self._images: Sequence[Image] = ()
        self._centre: float | None = None

    def cancel(self) -> None:
        """The question is settled; asked again within ANEW_S it is turned on the same way."""
        self._since = self._target = self._centre = None

    def plan(self, time: float, yaw: float, find_images: Callable[[], Sequence[Image]], axis: float, visibility: float
             ) -> float:
        """The turn (rad, counter-clockwise) still to be made at `time`, 0 when none is asked for.

        `find_images` is asked where the target may be each RETHINK_S only; `axis` is the array's end-fire in the body frame,
        `yaw` the rig's in the world.
        """
        settings = self.settings
        rethink = not abs(time - self._reckoned) < RETHINK_S
        if not abs(time - self._reckoned) < ANEW_S:
            self._direction = 0.0
        if rethink:
            self._reckoned, self._images = time, sorted(find_images(), key=lambda image: -image.weight)
        if not settings.enabled or len(self._images) < 2:
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
        if rethink or self._direction not in left:
            expected = expected_times([direction * room for direction, room in left.items()], *self._images[:2], axis,
                                      visibility if math.isfinite(visibility) else 0.0, settings)
            expected -= [SOONER_S * (direction == self._direction) for direction in left]
            self._direction = list(left)[int(np.argmin(expected))]
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


def expected_times(turns: Sequence[float], first: Image, second: Image, axis: float, visibility: float,
                   settings: RotationSettings) -> NDArray[np.float64]:
    """Seconds until each of the turns (rad) is expected to have decided between two images, over which is the true one.

    What is heard is the cosine of the angle from the array's axis. The false image explains it the worse the further its own
    course leads from the true one's, d^2 / (2 s^2) nats; s^2 holds what its unknown rate may make up for, and the array's
    error, averaged over the windows so far. Evidence of sight comes at once where one of the two enters the view. Decided
    is what has the odds, and the true image clear of end-fire, where front and back are one. A turn that decides nothing
    within the horizon costs more the less it tells.
    """
    images = (first, second)
    azimuth, rate, variance, rate_variance, weight = np.array(
        [(image.azimuth, image.rate, image.variance, image.rate_variance, max(image.weight, 1e-9)) for image in images]).T
    made = np.copysign(np.minimum(np.abs(turns)[:, None], settings.rate * HORIZON), np.asarray(turns)[:, None])
    course = (azimuth[:, None] + rate[:, None] * HORIZON) - made[:, None]  # (turns, images, times), in the body frame
    cosine, sine = np.cos(course - axis), np.sin(course - axis)
    unexplained = cosine[:, :1] - cosine[:, 1:]
    spread = variance[:, None] + rate_variance[:, None] * HORIZON**2
    doubt = (sine**2 * spread + 0.5 * np.minimum(spread, 1.0) ** 2
             + settings.broadside_sigma**2 * settings.window / HORIZON)[:, ::-1]  # of the false one, by which one is true
    heard = np.maximum.accumulate(0.5 * unexplained**2 / doubt, axis=-1)
    in_view = (np.cos(course) > math.cos(settings.half_view)).any(axis=1, keepdims=True)
    information = heard + SIGHT_NATS * visibility * np.logical_or.accumulate(in_view, axis=-1)
    needed = math.log(settings.needed_odds) - np.log(weight / weight[::-1])
    clear = np.abs(sine) > np.minimum(2.0 * np.sqrt(variance), 0.35)[:, None]
    decided = (information >= needed[:, None]) & clear
    late = HORIZON[-1] + np.maximum(needed - information[..., -1], 0.0)
    times = np.where(decided.any(axis=-1), HORIZON[np.argmax(decided, axis=-1)], late)
    return times @ (weight / weight.sum())
