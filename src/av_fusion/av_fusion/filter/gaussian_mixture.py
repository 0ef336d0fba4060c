"""The posterior: modes where the target may be, and a uniform background that says it is elsewhere, or that there is none."""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import remainder, tau
from operator import attrgetter
from typing import NamedTuple

from av_fusion.filter.gaussian_component import Mode, Motion, share_within
from av_fusion.measurement.measurements import Detection

AGREE, NEAR = math.radians(10.0), math.radians(25.0)  # modes closer together than this are one bearing, on the same side
HEAVIER = 1.5  # another mode must weigh so many times as much to become the primary one
LASTING_S = 2.0  # in so long something else that is always heard moves on
LIGHTEST = 1e-6  # what weighs less is no mode
WEIGHT = attrgetter('weight')


class Newborn(NamedTuple):
    """A direction in the world that may start a mode: `ratio` of the background's weight goes to it, `least` it has then."""

    azimuth: float
    variance: float
    ratio: float
    detection: Detection | None = None
    least: float = 0.0


class Mixture:
    """Weights of modes and background sum to one after `tidy`. Azimuths in rad, in the world; `lag` in s before now."""

    def __init__(self, motion: Motion, rate_variance: float, lost_variance: float) -> None:
        self.modes: list[Mode] = []
        self.background = 1.0
        self.misled = 0.0  # probability that something else is heard, were the target in the background
        self._motion, self._rate_variance, self._lost_variance = motion, rate_variance, lost_variance
        self._primary: Mode | None = None

    def predict(self, dt: float, agility: float, kept: float) -> None:
        """Move every mode by `dt` s; all but the share `kept` of what is known is forgotten."""
        for mode in self.modes:
            mode.predict(dt, self._motion, agility)
            mode.weight *= kept
        self.background += (1.0 - kept) * (1.0 - self.background)

    def wonder(self, dt: float, otherwise: float, width: float) -> None:
        """Forget over `dt` s whether it was the target that was heard; `otherwise` is how often it is not, in the long run.

        The rarer something else is heard, the shorter. Where it comes to be heard is anybody's guess, of which the one that a
        mode would have to make is the share `width`.
        """
        kept = math.exp(-dt / max(otherwise * LASTING_S, 1e-6))
        self.misled = otherwise + kept * (self.misled - otherwise)
        starts, ends = (1.0 - kept) * otherwise * width, (1.0 - kept) * (1.0 - otherwise)
        for mode in self.modes:
            mode.misled += (1.0 - mode.misled) * starts - mode.misled * ends

    def listen(self, direct: Sequence[float], anywhere: float) -> None:
        """Weigh by a sound, which is so likely to come from the target, by mode (`direct`), or from any direction.

        Something else that is heard on end is as predictable as a target: were it heard, then where the best of the other
        modes expects it. So a hundred sounds that contradict a mode weigh hardly more than one.
        """
        second, best = sorted((anywhere, anywhere, *direct))[-2:]
        for mode, likelihood in zip(self.modes, direct, strict=True):
            mode.weight *= _explain(mode, likelihood, second if likelihood == best else best)
        self.background *= _explain(self, 1.0, max(best, 1.0))

    def split(self, axis: float, lag: float) -> None:
        """Cut modes that lie on both sides of an axis."""
        self.modes = [part for mode in self.modes for part in mode.split(axis, lag)]

    def give_birth(self, lag: float, agility: float, newborns: Sequence[Newborn]) -> None:
        """Give directions where something was heard or seen their weight, by that of the background.

        What of the background is used up by it is the caller's to take off, who knows what else the measurement says of it.
        """
        known = tuple(self.modes)
        for new in newborns:
            weight, least = self.background * min(new.ratio, 50.0), self.background * min(new.least, 50.0)
            for mode in known:
                if mode.explains(new.azimuth, new.variance, lag):
                    mode.weight = max(mode.weight + weight, least)
                    break
            else:
                self.modes.append(self._born(new, max(weight, least), lag, agility))

    def _born(self, new: Newborn, weight: float, lag: float, agility: float) -> Mode:
        mode = Mode(weight, new.azimuth, new.variance, 0.0, self._rate_variance, self._motion.usual_elevation,
                    self._motion.usual_elevation_variance)
        if new.detection is not None:
            mode.update_elevation(new.detection.elevation, new.detection.elevation_variance, 1.0)
        if lag > 0.0:
            mode.predict(lag, self._motion, agility)
        return mode

    def tidy(self) -> None:
        """Normalise, merge modes that are one, give what is too wide or too light back to the background."""
        modes = sorted(self.modes, key=WEIGHT, reverse=True)
        total = self.background + sum([mode.weight for mode in modes])
        self.modes = kept = []
        self.background /= total
        for mode in modes:
            mode.weight /= total
            for twin in kept:
                if twin.resembles(mode):
                    twin.absorb(mode)
                    break
            else:
                if mode.weight >= LIGHTEST and mode.azimuth_variance <= self._lost_variance:
                    kept.append(mode)
                else:
                    share = mode.weight / (self.background + mode.weight)
                    self.misled += share * (mode.misled - self.misled)
                    self.background += mode.weight
        self.background = max(self.background, 1e-9)

    def primary(self) -> Mode | None:
        """The heaviest mode; the one chosen before stays until another is clearly heavier."""
        heaviest = max(self.modes, key=WEIGHT, default=None)
        if self._primary not in self.modes or heaviest.weight > HEAVIER * self._primary.weight:
            self._primary = heaviest
        return self._primary

    def share_of(self, primary: Mode, axis: float) -> float:
        """Probability, given that there is a target, of the bearing of `primary`.

        Modes that agree with it count, and what lies around it on its side of an axis (world azimuth) that sounds are mirrored
        about; nan for none.
        """
        side, agreeing, total = math.sin(primary.azimuth - axis), 0.0, 0.0
        for mode in self.modes:
            total += mode.weight
            apart = abs(remainder(primary.azimuth - mode.azimuth, tau))
            if apart < AGREE or (apart < NEAR and side * math.sin(mode.azimuth - axis) > 0.0):
                agreeing += mode.weight
        return agreeing / total

    def front_probability(self, yaw: float, ahead: float) -> float:
        """Probability, given that there is a target, that it will be within 90 degrees of `yaw` in `ahead` s."""
        front = total = 0.0
        for mode in self.modes:
            total += mode.weight
            front += mode.weight * share_within(0.5 * math.pi, mode.innovation(yaw, -ahead), mode.expected_variance(-ahead))
        return front / total


def _explain(part: Mode | Mixture, direct: float, other: float) -> float:
    """Likelihood of a sound that comes from the target (`direct`) or from something else; which of them it was is learnt."""
    total = (1.0 - part.misled) * direct + part.misled * other
    part.misled *= other / total
    return total
