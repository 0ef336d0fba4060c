"""Plans the rotation of the rig that resolves the front-back ambiguity soonest.

The true source keeps its course in the world, while its mirror image moves by twice the rotation. The time until
this is evident depends on the direction relative to the array, on possible motion of source and image, and on whether one of
them enters the camera's view.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap
from av_fusion.measurement.measurements import CameraMeasurement
from av_fusion.measurement.vectors import Vector

HORIZON = np.arange(0.2, 6.1, 0.2)  # s, future times for which the resolution is predicted
DONE = math.radians(2.0)  # a rotation is complete when less than this is left
REVERSAL_GAIN_S = 2.0  # predicted gain of time for which the rig reverses its rotation
REPLAN_S = 0.2  # time between predictions, of looks, too
ASKED_S = 10.0  # for which a rotation that a person asks for is requested
SIGHT_NATS = 6.0  # information of an image of one of the directions, in clear air
RATE = math.radians(40.0)  # rad/s, expected of the rotation
SECTOR = math.pi  # rad, largest rotation to either side of the heading of the first request
BROADSIDE_SIGMA, WINDOW_S = math.radians(2.0), 0.5  # error of a direction of arrival at broadside, and the window that it is of


class Candidate(NamedTuple):
    """A possible direction of the target.

    Parameters:
        azimuth (rad), variance (rad^2): azimuth from the rig's heading and its variance.
        rate (rad/s), rate_variance (rad^2/s^2): rate of the azimuth in the world and its variance.
        weight: probability of the candidate.
        elevation (rad): in the world.
    """

    azimuth: float
    variance: float
    rate: float
    rate_variance: float
    weight: float
    elevation: float = 0.0


NO_CAMERA = CameraMeasurement(-math.inf, (), half_view=0.0)  # sees nothing


class RotationPlanner:
    """Requests a rotation while the ambiguity persists and a rotation helps to resolve it.

    Parameters:
        enabled: whether rotations are requested.
        fixed (rad): non-zero requests this rotation while the ambiguity persists, as in the publication.
    """

    def __init__(self, enabled: bool = True, fixed: float = 0.0) -> None:
        self._enabled, self._fixed = enabled, fixed
        self._is_open = False  # whether there is an ambiguity
        self._direction = 0.0
        self._planned = -math.inf
        self._pairs: Sequence[Sequence[Candidate]] = ()
        self._centre: float | None = None
        self._offset = 0.0  # of the yaw from there, not wrapped
        self._asked = -math.inf

    def ask(self, time: float) -> None:
        """Request a rotation from `time` (s) on until the ambiguity is resolved, for at most ASKED_S.

        Before looks. Raises ValueError while there is no ambiguity, or rotations are not enabled.
        """
        if not self._enabled:
            raise ValueError('no rotations are requested: `rotation` is false, or `method` has none')
        if not self._is_open:
            raise ValueError('a rotation would not help now: front and back are resolved, or nothing is heard')
        self._asked = time

    def is_asked(self, time: float) -> bool:
        """Whether a rotation that was asked for is requested at `time` (s)."""
        return 0.0 <= time - self._asked < ASKED_S

    def cancel(self) -> None:
        """Cancel the rotation because the ambiguity is resolved; the next one prefers its direction."""
        self._is_open, self._centre, self._offset = False, None, 0.0
        self._asked = -math.inf

    def plan(self, time: float, yaw: float, find_candidates: Callable[[], Sequence[Sequence[Candidate]]], axis: Vector,
             image: CameraMeasurement, confirm: float) -> float:
        """The remaining rotation (rad, counter-clockwise), 0 when none is requested.

        Parameters:
            time (s): time of the request.
            yaw (rad): yaw of the rig in the world.
            find_candidates: returns the possible directions of each target; it is called every REPLAN_S only.
            axis: between the mirror images, in the level frame of the rig's heading.
            image: the newest one, for what the camera can see.
            confirm: probability of one direction from which the ambiguity counts as resolved.
        """
        replan = not abs(time - self._planned) < REPLAN_S
        if replan:
            ranked = [sorted(found, key=lambda candidate: -candidate.weight) for found in find_candidates()]
            self._planned, self._pairs = time, [found[:2] for found in ranked if len(found) >= 2]
        if not self._enabled or not self._pairs:
            self.cancel()
            return 0.0
        self._is_open = True
        self._centre = yaw if self._centre is None else self._centre
        offset = self._offset = self._offset + wrap(yaw - self._centre - self._offset)
        if self._fixed:
            return self._fixed if abs(offset + self._fixed) <= SECTOR else 0.0
        left = {direction: SECTOR - direction * offset for direction in (1.0, -1.0)}
        left = {direction: min(room, math.pi / 2.0) for direction, room in left.items() if room > DONE}
        if not left:
            return 0.0
        if replan or self._direction not in left:
            turns = [direction * room for direction, room in left.items()]
            expected = joint_times(turns, self._pairs, axis, image, confirm)
            gains = [REVERSAL_GAIN_S * (direction == self._direction) for direction in left]
            self._direction = list(left)[int(np.argmin(np.subtract(expected, gains)))]
        return self._direction * left[self._direction]


def joint_times(turns: Sequence[float], pairs: Sequence[Sequence[Candidate]], axis: Vector,
                image: CameraMeasurement, confirm: float) -> NDArray[np.float64]:
    """Mean expected time (s, (n,)) until each rotation has resolved one ambiguity of several, weighted by existence.

    The sum over targets of the probability of existence times the expected time is the integral over time of the expected
    number of ambiguities that are still open, which the rotation with the smallest mean keeps lowest.

    Parameters:
        turns (n,) (rad), axis, image, confirm: see `expected_times`.
        pairs: both candidates of each target, whose weights sum to its probability of existence.
    """
    times = [expected_times(turns, first, second, axis, image, confirm) for first, second in pairs]
    return np.asarray(np.average(times, axis=0, weights=[max(first.weight + second.weight, 1e-9) for first, second in pairs]))


def expected_times(turns: Sequence[float], first: Candidate, second: Candidate, axis: Vector,
                   image: CameraMeasurement, confirm: float) -> NDArray[np.float64]:
    """Expected time (s) until each of the rotations has resolved which of two candidates is true.

    A linear array measures the cosine of the angle from its axis. The measurements contradict the false candidate with
    d^2 / (2 s^2) nats, d being the difference of the cosines of both courses; s^2 contains what the unknown rate of the false
    candidate may explain, and the array's error, averaged over the windows so far. The camera contributes at once when one of
    the candidates enters its view. The ambiguity is resolved when the odds are reached and the true candidate is clear of
    end-fire, where front and back coincide. A rotation that does not resolve it within the horizon costs more the less
    information it gives.

    Parameters:
        turns (n,) (rad): rotations, counter-clockwise.
        first, second: the candidates.
        axis: of the array, in the level frame of the rig's heading.
        image: the newest one, for what the camera can see.
        confirm: probability of one candidate from which the ambiguity counts as resolved.
    """
    azimuth, rate, variance, rate_variance, weight, elevation = np.array(
        [(c.azimuth, c.rate, c.variance, c.rate_variance, max(c.weight, 1e-9), c.elevation) for c in (first, second)]).T
    turned = np.copysign(np.minimum(np.abs(turns)[:, None], RATE * HORIZON), np.asarray(turns)[:, None])
    course = (azimuth[:, None] + rate[:, None] * HORIZON) - turned[:, None]  # (turns, candidates, times), in the body frame
    x, y, z = axis
    along, sine = x * np.cos(course) + y * np.sin(course), x * np.sin(course) - y * np.cos(course)
    cosine = np.cos(elevation)[:, None] * along + np.sin(elevation)[:, None] * z
    unexplained = cosine[:, :1] - cosine[:, 1:]
    spread = variance[:, None] + rate_variance[:, None] * HORIZON**2
    error = (sine**2 * spread + 0.5 * np.minimum(spread, 1.0) ** 2
             + BROADSIDE_SIGMA**2 * WINDOW_S / HORIZON)[:, ::-1]  # of the false candidate, by the true one
    acoustic = np.maximum.accumulate(0.5 * unexplained**2 / error, axis=-1)
    middle = math.atan2(image.view[1][0], image.view[0][0])
    in_view = (np.cos(course - middle) > math.cos(image.half_view)).any(axis=1, keepdims=True)
    information = acoustic + SIGHT_NATS * image.visibility * np.logical_or.accumulate(in_view, axis=-1)
    needed = math.log(confirm / (1.0 - confirm)) - np.log(weight / weight[::-1])
    clear = np.abs(sine) > np.minimum(2.0 * np.sqrt(variance), 0.35)[:, None]
    decided = (information >= needed[:, None]) & clear
    beyond = HORIZON[-1] + np.maximum(needed - information[..., -1], 0.0)
    times = np.where(decided.any(axis=-1), HORIZON[np.argmax(decided, axis=-1)], beyond)
    return times @ (weight / weight.sum())
