"""The vehicle's answer to commanded yaw rates, estimated while the body turns.

Equations and sources: docs/reference/pointing.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_common.angles import wrap
from av_common.stopping import COMMAND_LIFETIME_S, LONGEST_DEAD_TIME_S, LONGEST_LAG_S
from av_common.timeline import Timeline

GRID_S = 0.01              # step of the models' trajectories
MEMORY = 500               # steps that are kept, 5 s
PAIR_S, LONGEST_PAIR_S = 0.1, 0.5   # time between two angles that are compared
FORGET_S = 8.0             # time of turning after which what was seen counts by 1/e
LEAST_TURN = math.radians(0.3)      # smaller turns between two angles tell nothing
ANGLE_NOISE = math.radians(0.1)     # least standard deviation of the difference of two angles
WEAK_TURN = math.radians(3.0)       # turns of less than this do not change the expected gain of 1
DRIFTING = math.radians(10.0)       # rad/s, standard deviation of a rate that nothing commands: of a boat in a current, or wind
DRIFT_S = 3.0              # time after which what was seen of it counts by 1/e
FASTEST = math.radians(150.0)       # rad/s, of vehicles; between angles that are further apart an estimator corrected itself
TEMPER = 3.0               # successive differences count as one in three: errors of a wrong model are correlated
LEAST_GAIN, LARGEST_GAIN = 0.5, 1.3

LAGS = np.array([0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0, 1.25, LONGEST_LAG_S])  # s
DEAD_TIMES = np.arange(0.0, LONGEST_DEAD_TIME_S + 0.01, 0.05)  # s


@dataclass(frozen=True)
class Response:
    """Answer of a vehicle to its commanded yaw rate: a dead time, then a first-order lag.

    Parameters:
        dead_time, lag (s): estimates.
        gain: yaw rate that is reached, relative to the commanded one.
        uncertainty (s): standard deviation of the sum of dead time and lag.
    """

    dead_time: float = 0.1
    lag: float = 0.4
    gain: float = 1.0
    uncertainty: float = 0.2


class Ahead(NamedTuple):
    """State of the body at the time at which a command given now begins to show.

    Parameters:
        yaw (rad), rate (rad/s): of the body.
        further (rad): turn from then on, if 0 was commanded.
    """

    yaw: float
    rate: float
    further: float


class BodyMotion:
    """Predicts the body's yaw from its measured yaw and from the commanded rates that have not shown yet.

    A vehicle of dead time d turns at time t as one without it did at t - d. So each candidate lag has one trajectory, and
    each candidate dead time is a place in it. Commands and angles may come at any times; times are monotonic, in s.

    Attributes:
        response: the estimated answer.
        following: share of the commanded turn that the vehicle made; near 0 while a pilot holds it.
        drift (rad/s): rate at which it turns besides.

    Parameters:
        prior: the answer that is expected, with its uncertainty.
    """

    def __init__(self, prior: Response | None = None) -> None:
        self.response = prior or Response()
        self.following, self.drift = 1.0, 0.0
        sigma = self.response.uncertainty
        self._log_prior = -0.5 * (((LAGS[:, None] - self.response.lag) / sigma) ** 2
                                  + ((DEAD_TIMES - self.response.dead_time) / (0.5 * sigma)) ** 2)
        self._sums = np.zeros((2, LAGS.size, DEAD_TIMES.size))   # of (model's turn)^2, and of that times the measured turn
        self._measured, self._count = 0.0, 0.0                   # sum of (measured turn)^2, number of turns
        self._drifted, self._by_time = np.zeros_like(self._sums[0]), np.zeros(2)    # model's turn, measured turn, time; by time
        self._blend = np.zeros(LAGS.size)
        self._turns, self._rates = np.zeros((LAGS.size, MEMORY)), np.zeros(LAGS.size)
        self._step, self._command, self._commanded = 0, 0.0, -math.inf
        self._yaws: Timeline[float] = Timeline(MEMORY * GRID_S)  # measured yaw without jumps by 2 pi
        self._pair: tuple[float, float] | None = None
        self._estimate()

    def command(self, time: float, rate: float) -> None:
        """Note that the body turns by a rate (rad/s) from `time` (s) on."""
        self.advance(time)
        self._command, self._commanded = rate, time

    def advance(self, time: float) -> None:
        """Continue the models to `time` (s) with the newest command. After a gap or a step back of 1 s they start again."""
        step = math.floor(time / GRID_S)
        if abs(step - self._step) > 1.0 / GRID_S:
            self._turns[:], self._rates[:] = 0.0, 0.0
            self._step, self._command, self._pair = step, 0.0, None
        decay = np.exp(-GRID_S / LAGS)
        while self._step < step:
            self._step += 1
            alive = self._step * GRID_S <= self._commanded + COMMAND_LIFETIME_S
            self._rates = (self._command if alive else 0.0) * (1.0 - decay) + self._rates * decay
            before, now = (self._step - 1) % MEMORY, self._step % MEMORY
            self._turns[:, now] = self._turns[:, before] + GRID_S * self._rates

    def measure(self, time: float, yaw: float) -> None:
        """Note a measured yaw (rad) of `time` (s), from which the answer is estimated, too. Times that go back are ignored."""
        if not math.isfinite(yaw) or time <= self._yaws.newest:
            return
        if self._yaws.entries:
            _, before = self._yaws.entries[-1]
            yaw = before + float(wrap(yaw - before))
        self._yaws.add(time, yaw)
        if self._pair is None or time - self._pair[0] > LONGEST_PAIR_S or not self._remembered(self._pair[0]):
            self._pair = (time, yaw)
        elif time - self._pair[0] >= PAIR_S:
            self._learn(self._pair[0], time, yaw - self._pair[1])
            self._pair = (time, yaw)

    def rate(self, time: float) -> float:
        """Measured yaw rate (rad/s) over the newest PAIR_S, 0 where it is unknown at `time` (s)."""
        newest = self._yaws.newest
        if time - newest > LONGEST_PAIR_S:
            return 0.0
        return (self.yaw(newest) - self.yaw(newest - PAIR_S)) / PAIR_S

    def yaw(self, time: float) -> float:
        """Yaw (rad) at `time` (s): between measured ones, beyond them by the model, without any by the model alone."""
        if time <= self._yaws.newest:
            before, after, share = self._yaws.around(time)
            return before + share * (after - before)
        turned = self._modelled(time - self.response.dead_time)
        if not self._yaws.entries:
            return turned
        known, yaw = self._yaws.entries[-1]
        return yaw + turned - self._modelled(known - self.response.dead_time) + self.drift * (time - known)

    def ahead(self, time: float) -> Ahead:
        """What the commands until `time` (s) lead to."""
        rates = self.response.gain * self._blend * self._rates
        return Ahead(self.yaw(time + self.response.dead_time), float(rates.sum()), float(rates @ LAGS))

    def _remembered(self, time: float) -> bool:
        return self._step * GRID_S - time < (MEMORY - 2) * GRID_S - DEAD_TIMES[-1]

    def _modelled(self, time: float) -> float:
        """Turn (rad) of the models at `time` (s), without dead time, weighted by their probabilities."""
        return float(self.response.gain * self._blend @ self._at(time, np.zeros(1))[:, 0])

    def _at(self, time: float, dead_times: NDArray) -> NDArray:
        """Turns (rad, (lags, dead times)) at `time` less each dead time; beyond the newest step by the newest rate."""
        places = np.clip((time - dead_times) / GRID_S, self._step - MEMORY + 1, self._step + 1)
        lower = np.minimum(np.floor(places).astype(int), self._step - 1)
        earlier, later = self._turns[:, lower % MEMORY], self._turns[:, (lower + 1) % MEMORY]
        return earlier + (places - lower) * (later - earlier)

    def _learn(self, begin: float, end: float, turn: float) -> None:
        modelled = self._at(end, DEAD_TIMES) - self._at(begin, DEAD_TIMES)
        time = end - begin
        if abs(turn) > FASTEST * time:
            return
        recent = math.exp(-time / DRIFT_S)
        self._drifted = recent * self._drifted + modelled * time
        self._by_time = recent * self._by_time + np.array([turn * time, time**2])
        if max(abs(turn), float(np.abs(modelled).max())) >= LEAST_TURN:
            keep = math.exp(-time / FORGET_S)
            self._sums = keep * self._sums + np.array([modelled**2, modelled * turn])
            self._measured = keep * self._measured + turn**2
            self._count = keep * self._count + 1.0
        self._estimate()

    def _estimate(self) -> None:
        (squares, products), drifted = self._sums, self._drifted
        turned, times = self._by_time
        weak, still = WEAK_TURN**2, (WEAK_TURN / DRIFTING) ** 2   # a gain of 1 is expected, and no drift
        times += still
        gains = np.clip((times * (products + weak) - drifted * turned) / (times * (squares + weak) - drifted**2), 0.0, 1.5)
        drifts = (turned - gains * drifted) / times
        errors = self._measured - 2.0 * gains * products + gains**2 * squares - times * drifts**2
        variance = max(float(errors.min()) / max(self._count, 1.0), ANGLE_NOISE**2)  # of all models that of the best
        exponent = self._log_prior - errors / (2.0 * TEMPER * variance)
        weights = np.exp(exponent - exponent.max())
        weights /= weights.sum()
        lags, dead_times = weights.sum(axis=1), weights.sum(axis=0)
        self._blend = lags
        lag, dead_time = float(lags @ LAGS), float(dead_times @ DEAD_TIMES)
        total = LAGS[:, None] + DEAD_TIMES
        self.following, self.drift = float((weights * gains).sum()), float((weights * drifts).sum())
        self.response = Response(dead_time, lag, min(max(self.following, LEAST_GAIN), LARGEST_GAIN),
                                 math.sqrt(float((weights * (total - lag - dead_time) ** 2).sum())))
