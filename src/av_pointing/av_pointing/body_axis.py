"""The body's yaw: steered by where the body will be when a command shows, as fast as it can still be stopped in time."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from av_common.angles import wrap
from av_common.limited_axis import AxisLimits, LimitedAxis
from av_common.stopping import YawAnswer, fastest_stoppable
from av_pointing.response import BodyMotion, Response

DELAY_FACTOR, FASTEST = 0.35, 4.0  # of the bandwidth (1/s), see `BodyAxis.bandwidth`
LONGEST_AGE_S = 1.5  # for which an aim is continued: five times as long as a bearing counts
DEAD_BAND = math.radians(0.5)  # error below which nothing moves: the noise of a bearing that is seen
RATE_MEMORY_S = 0.6                # of the rates that give the target's acceleration
LEAST_FOLLOWED = 0.2               # share of the commanded turns; from a few degrees on, by the prior of `BodyMotion`


class Aim(NamedTuple):
    """A direction for the body.

    Parameters:
        azimuth (rad): in the body's frame.
        rate (rad/s): its rate in the world.
        time (s): for which both are valid, on the clock of the commands.
    """

    azimuth: float
    rate: float
    time: float


class BodyAxis:
    """Yaw rates of the body, within their limits.

    Attributes:
        motion: predicts the yaw; is to be told of measured yaws.

    Parameters:
        limits: of yaw rate and acceleration.
        response: expected answer of the vehicle.
    """

    def __init__(self, limits: AxisLimits, response: Response) -> None:
        self.motion = BodyMotion(response)
        self._rates: deque[tuple[float, float]] = deque(maxlen=100)   # time, rate of the aim
        self._axis = LimitedAxis(limits)

    def limit_rate(self, rate: float) -> None:
        """Turn no faster than `rate` (rad/s) from now on."""
        self._axis.limits = replace(self._axis.limits, rate=rate)

    @property
    def limits(self) -> AxisLimits:
        """Of yaw rate and acceleration."""
        return self._axis.limits

    @property
    def velocity(self) -> float:
        """Commanded yaw rate (rad/s)."""
        return self._axis.velocity

    @property
    def problem(self) -> str:
        """Why the body seems not to turn while it is commanded to; empty where it turns."""
        if self.velocity == 0.0 or self.motion.following >= LEAST_FOLLOWED:
            return ''
        return (f'odometry shows {100.0 * self.motion.following:.0f} % of the commanded turns: the vehicle does not obey, or '
                'the yaw of its odometry is frozen, and directions in the world are wrong')

    @property
    def bandwidth(self) -> float:
        """Share of the predicted error that is turned in 1 s (1/s): the less the later the vehicle answers."""
        response = self.motion.response
        return 1.0 / (1.0 / FASTEST + DELAY_FACTOR * (response.dead_time + response.lag))

    @property
    def acceleration(self) -> float:
        """Acceleration (rad/s^2) of the aim: the slope of its recent rates, the less of it the less certain it is."""
        if len(self._rates) < 4:
            return 0.0
        times, rates = np.array(self._rates).T
        times, rates = times - times.mean(), rates - rates.mean()
        squares = float(times @ times)
        slope = float(times @ rates) / squares
        variance = float(((rates - slope * times) ** 2).sum()) / (len(times) - 2) / squares
        return slope - variance / slope if slope * slope > variance else 0.0

    def see(self, aim: Aim) -> None:
        """Note a new bearing."""
        while self._rates and not aim.time - RATE_MEMORY_S < self._rates[0][0] < aim.time:
            self._rates.popleft()
        most = self._axis.limits.rate
        self._rates.append((aim.time, min(max(aim.rate, -most), most)))

    def turn(self, time: float, dt: float, aim: Aim, left: float, fastest: float = math.inf) -> None:
        """Turn towards an aim, as fast as the body can still be stopped in time if no further measurement comes.

        Parameters:
            time (s): time of the command.
            dt (s): duration of the step.
            aim: where to.
            left (s): time until the rate must be 0.
            fastest (rad/s): limit of the rate, in addition to that of the axis.
        """
        ahead, axis, response = self.motion.ahead(time), self._axis, self.motion.response
        before, limits = axis.velocity, axis.limits
        elapsed = min(time + response.dead_time - aim.time, LONGEST_AGE_S)
        acceleration = self.acceleration if aim.rate else 0.0
        rate = min(max(aim.rate + acceleration * elapsed, -limits.rate), limits.rate)
        azimuth = aim.azimuth + (aim.rate + 0.5 * acceleration * elapsed) * elapsed
        rate -= self.motion.drift
        error = wrap(azimuth - ahead.yaw + self.motion.yaw(aim.time)) - ahead.further + rate * response.lag
        beyond = math.copysign(max(abs(error) - DEAD_BAND, 0.0), error)
        axis.follow(beyond, (rate + response.lag * acceleration) / response.gain, dt, fastest, self.bandwidth)
        wanted, sense = axis.velocity, math.copysign(1.0, ahead.rate or axis.velocity)
        answer = YawAnswer(response.dead_time, response.lag, response.gain)
        most = fastest_stoppable(abs(ahead.rate), left, dt, limits.acceleration, answer) if dt else 0.0
        if sense * wanted > most:
            axis.velocity = sense * min(max(most, sense * before - limits.acceleration * dt), sense * wanted)

    def stop(self, dt: float) -> None:
        """Bring the commanded rate to 0 as fast as the limits allow, in a step of `dt` s."""
        self._axis.stop(dt)

    def command(self, time: float, left: float, moves: bool) -> float:
        """The yaw rate (rad/s) of the command at `time` (s), reduced so that it is 0 in time.

        Parameters:
            time (s): time of the command.
            left (s): time until the rate must be 0.
            moves: whether the vehicle is to follow it.
        """
        self._axis.limit(self._axis.limits.acceleration * max(left, 0.0))
        self.motion.command(time, self._axis.velocity if moves else 0.0)
        return self._axis.velocity
