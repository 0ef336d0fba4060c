"""Sight corrects hearing: where the array's axis really points, how long its baseline really is, how its delays are bent.

A pair of microphones measures the cosine m of the angle between the sound and its axis. While sight is sure where the target
is, the truth is known, and so is what the ear made of it:

    m = b + (1 + s) cos(d + o) cos(e) + c1 P2(cos d) + c2 P3(cos d)

with d, e the target's azimuth from the nominal axis and elevation, o the axis' offset, s the error of baseline (or speed of
sound), b a delay between the channels, and two Legendre polynomials for a body that bends delays smoothly. Recursive least
squares with exponential forgetting (Ljung, System Identification, 1999, eq. 11.12) estimates these five numbers; the prior is
that the array is as described, and forgetting leads back to it rather than to nothing (stabilised forgetting, Kulhavy and
Zarrop 1993), so that directions that were never heard keep their prior.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field
from math import remainder, tau
from operator import mul
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_fusion.measurement.measurements import DoaMeasurement, Hypothesis

ALIKE_S = 5.0  # so long errors of sight stay alike
LEAST_CONFIDENCE = 0.5  # of what is seen and of what is heard, for a comparison
NAMES = ('offset', 'scale', 'delay', 'curve 2', 'curve 3')


@dataclass(frozen=True)
class RefinementSettings:
    """`memory` (s) is how long a comparison counts; `sigmas` what is believed of each number before (rad, then shares of m).

    No correction exceeds `bound` times its sigma; comparisons further off than `gate` standard deviations are not used.
    """

    enabled: bool = True
    memory: float = 60.0
    sigmas: tuple[float, ...] = (math.radians(5.0), 0.05, 0.02, 0.02, 0.02)
    bound: float = 2.0
    gate: float = 4.0


@dataclass
class Refinement:
    """Recursive estimate of the numbers; `compare` learns, `correct` applies."""

    settings: RefinementSettings = field(default_factory=RefinementSettings)

    def __post_init__(self) -> None:
        self._prior = np.diag(1.0 / np.square(self.settings.sigmas))
        self._bounds = self.settings.bound * np.asarray(self.settings.sigmas)
        self._gained, self._covariance = np.zeros_like(self._prior), np.linalg.inv(self._prior)  # information beyond the prior
        self._vector = np.zeros(len(NAMES))
        self._time = -math.inf
        self._values = [0.0] * len(NAMES)
        self.compared = 0

    @property
    def values(self) -> NDArray[np.float64]:
        """The numbers (5,)."""
        return np.array(self._values)

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """How well each number is known (5,)."""
        return np.sqrt(np.diag(self._covariance))

    def compare(self, time: float, measured: float, azimuth: float, elevation: float, variance: float,
                seen_variance: float = 0.0) -> bool:
        """Learn from one sound: its cosine, and the target's direction from the nominal axis as it was seen (rad).

        `variance` is that of the cosine's error, of which successive sounds must be independent or it be widened.
        `seen_variance` (rad^2) is that of where the target was seen; its error stays alike for ALIKE_S, for a camera that looks
        a degree aside does so for long. Returns whether the comparison was used.
        """
        if not (self.settings.enabled and math.isfinite(measured) and 0.0 < variance < math.inf):
            return False
        slopes = sensitivities(azimuth, elevation)
        row = np.array(slopes)
        missing = measured - math.cos(azimuth) * math.cos(elevation)
        seconds = min(max(time - self._time, 0.01), ALIKE_S)
        variance += seen_variance * slopes[0] ** 2 * ALIKE_S / seconds
        spread = float(row.dot(self._covariance).dot(row)) + variance
        if (missing - sum(map(mul, slopes, self._values))) ** 2 > self.settings.gate**2 * spread:
            return False
        kept = math.exp(-min(max(time - self._time, 0.0), 1.0) / self.settings.memory)
        self._time = max(self._time, time)
        weighed = row / variance
        self._gained = kept * self._gained + row[:, None] * weighed
        self._vector = kept * self._vector + missing * weighed
        self._covariance = np.linalg.inv(self._prior + self._gained)
        values = self._covariance.dot(self._vector)
        self._values = np.minimum(np.maximum(values, -self._bounds), self._bounds).tolist()
        self.compared += 1
        return True

    def correct(self, measured: float, azimuth: float) -> tuple[float, float]:
        """The cosines that the nominal array would have measured of a level target near `azimuth`, and of its mirror image."""
        across, *along = sensitivities(azimuth, 0.0)
        offset, *others = self._values
        turned, common = across * offset, measured - sum(map(mul, along, others))
        return min(max(common - turned, -1.0), 1.0), min(max(common + turned, -1.0), 1.0)

    def describe(self) -> dict[str, str]:
        """What was learnt, for people."""
        units = ((math.degrees(1.0), 'deg'), *(((100.0, '%'),) * 4))
        return {name: f'{scale * value:+.2f} +- {scale * sigma:.2f} {unit}'
                for name, value, sigma, (scale, unit) in zip(NAMES, self.values, self.sigmas, units, strict=True)}


def sensitivities(azimuth: float, elevation: float) -> tuple[float, float, float, float, float]:
    """How the measured cosine changes with each number, at a direction from the nominal axis (rad)."""
    level = math.cos(elevation)
    x = math.cos(azimuth) * level
    return -math.sin(azimuth) * level, x, 1.0, 1.5 * x * x - 0.5, (2.5 * x * x - 1.5) * x


class SeenCourse:
    """Where the target was seen of late and how surely, so that what was heard can be compared at its own time."""

    def __init__(self, gap: float = 0.4, keep: float = 3.0) -> None:
        self._gap, self._keep = gap, keep
        self._seen: list[tuple[float, float, float, float]] = []

    def add(self, time: float, azimuth: float, elevation: float, variance: float) -> None:
        """A sighting: world azimuth and elevation in rad, the azimuth's variance. One that comes out of order is ignored."""
        if self._seen and time <= self._seen[-1][0]:
            return
        del self._seen[:bisect_right(self._seen, (time - self._keep, math.inf))]
        self._seen.append((time, azimuth, elevation, variance))

    def at(self, time: float) -> tuple[float, float, float] | None:
        """World azimuth, elevation, the azimuth's variance at `time`, between two sightings at most `gap` s apart; or None."""
        after = bisect_left(self._seen, (time,))
        if after in (0, len(self._seen)) or self._seen[after][0] - self._seen[after - 1][0] > self._gap:
            return None
        (t0, a0, e0, _), (t1, a1, e1, v1) = self._seen[after - 1:after + 1]
        share = (time - t0) / (t1 - t0)
        return remainder(a0 + share * remainder(a1 - a0, tau), tau), e0 + share * (e1 - e0), v1


class Pair(NamedTuple):
    """Two mirror images as one cosine about the array's axis (body azimuth in [0, pi)); `half` is the first one's angle."""

    axis: float
    half: float

    @staticmethod
    def of(sound: DoaMeasurement) -> Pair | None:
        """None for a sound of other than two hypotheses."""
        if len(sound.hypotheses) != 2:
            return None
        first, second = sound.hypotheses
        axis = remainder(first.azimuth + 0.5 * remainder(second.azimuth - first.azimuth, tau), tau) % math.pi
        return Pair(axis, remainder(first.azimuth - axis, tau))

    def corrected(self, sound: DoaMeasurement, refinement: Refinement) -> DoaMeasurement:
        """The sound with both images where a nominal array would have heard them."""
        if not refinement.compared:
            return sound
        time, (first, second), *others = sound
        here, mirrored = refinement.correct(math.cos(self.half), self.half)
        return DoaMeasurement(time, (self._moved(first, here, self.half), self._moved(second, mirrored, -self.half)), *others)

    def _moved(self, image: Hypothesis, cosine: float, side: float) -> Hypothesis:
        return Hypothesis(remainder(self.axis + math.copysign(math.acos(cosine), side), tau), *image[1:])
