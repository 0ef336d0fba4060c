"""The direction of a component at the capture time of a measurement."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from av_fusion.measurement.vectors import IDENTITY, ZERO, Rows, Vector, combined, dot, offset, turned

Row = tuple[float, float]


class Lag(NamedTuple):
    """How much earlier than a density a measurement is.

    Parameters:
        seconds (s): time since then.
        moved (m): displacement of the rig since then, in the world.
        turn: rotation of the rig from now to then, in the world.
    """

    seconds: float = 0.0
    moved: Vector = ZERO
    turn: Rows = IDENTITY


NOW = Lag()


class PastState(NamedTuple):
    """A Gaussian of the direction in the plane that touches the sphere at its mean.

    Parameters:
        direction, left, above: mean, and axes of the plane; unit vectors in the world.
        hh, hv, vv (rad^2): covariance of the direction, whatever the mode.
        modes (k,): probabilities of the modes of motion.
        offsets (k, 2), spreads (k, 2, 2): mean of the direction in each mode from that of all, and its covariance.
        gains (k, 5, 2): covariance of the component's present state with the direction along both axes, by mode.
        lag: how much earlier it is.
    """

    direction: Vector
    left: Vector
    above: Vector
    hh: float
    hv: float
    vv: float
    modes: NDArray[np.float64]
    offsets: NDArray[np.float64]
    spreads: NDArray[np.float64]
    gains: NDArray[np.float64]
    lag: Lag

    def shifted(self, across: float, up: float) -> PastState:
        """The state with direction and axes moved by `across` and `up` (rad) along a great circle."""
        direction, left, above = self.direction, self.left, self.above
        length = math.hypot(across, up)
        if length < 1e-9:
            return self
        h, v, cosine, sine = across / length, up / length, math.cos(length), math.sin(length)
        along = combined(h, left, v, above)
        change = combined(cosine - 1.0, along, -sine, direction)
        return self._replace(direction=combined(cosine, direction, sine, along), left=combined(1.0, left, h, change),
                             above=combined(1.0, above, v, change))

    def turned(self, rows: Rows) -> PastState:
        """The state with direction and axes turned by a rotation."""
        return self._replace(direction=turned(rows, self.direction), left=turned(rows, self.left),
                             above=turned(rows, self.above))

    def variance(self, row: Row) -> float:
        """Variance (rad^2) of the direction along a row of derivatives, whatever the mode."""
        h, v = row
        return h * h * self.hh + 2.0 * h * v * self.hv + v * v * self.vv

    def variances(self, row: Row) -> NDArray[np.float64]:
        """Variance (k,) of the direction along a row of derivatives in each mode."""
        along = np.array(row)
        return np.asarray(self.spreads @ along @ along)

    def deviations(self, row: Row) -> NDArray[np.float64]:
        """Mean (k,) of the direction along a row of derivatives in each mode, from that of all."""
        return np.asarray(self.offsets @ np.array(row))

    def beyond(self, value: float, row: Row, ends: Sequence[tuple[float, float]], seen: float
               ) -> tuple[NDArray[np.float64], ...]:
        """Moments by mode of a quantity whose density is multiplied by 1 - `seen` but beyond some ends.

        Returns (k,) each: what is left of the density, and the changes of the quantity's mean and variance.

        Parameters:
            value: mean of the quantity, whatever the mode.
            row: its derivatives with respect to the direction across and up.
            ends: side (1 or -1) of the values that are left as they are, and where these begin.
            seen: see above.
        """
        variances = np.maximum(self.variances(row), 1e-12)
        sigmas, means = np.sqrt(variances), self.deviations(row) + value
        share = first = second = np.zeros(len(means))
        for side, end in ends:  # moments of a standard normal variable beyond each end
            start = side * (end - means) / sigmas
            density = np.exp(-0.5 * start**2) / math.sqrt(math.tau)
            tail = np.array([0.5 * math.erfc(each / math.sqrt(2.0)) for each in start.tolist()])
            share, first, second = share + tail, first + side * density, second + tail + start * density
        left = 1.0 - seen + seen * share
        shift = seen * first / left
        return left, shift * sigmas, ((1.0 - seen + seen * second) / left - shift**2 - 1.0) * variances

    def offset(self, target: Vector) -> tuple[float, float]:
        """Where a direction is in the plane, along both axes (rad)."""
        return offset(self.direction, self.left, self.above, target)

    def above_plane(self, normal: Vector) -> tuple[float, Row]:
        """Signed distance (rad) from the plane with this unit normal, and its derivatives along both axes."""
        h, v = dot(normal, self.left), dot(normal, self.above)
        steepness = max(math.hypot(h, v), 1e-9)
        return math.atan2(dot(normal, self.direction), steepness), (h / steepness, v / steepness)


class Deviation(NamedTuple):
    """A scalar measurement compared with a prediction.

    Parameters:
        row: derivatives of the measured value with respect to the direction across and up.
        innovations (k,): measured minus predicted value, in each mode of motion.
        totals (k,): variance of the innovation.
        noise: the measurement's part of it.
    """

    row: Row
    innovations: NDArray[np.float64]
    totals: NDArray[np.float64]
    noise: float

    @classmethod
    def of(cls, past: PastState, row: Row, innovation: float, noise: float) -> Deviation:
        """The deviation of a value whose derivatives are `row`, by its innovation whatever the mode."""
        return cls(row, innovation - past.deviations(row), past.variances(row) + noise, noise)


def share_within(half_width: float, offset: float, variance: float) -> float:
    """Probability that a normal variable lies within +-half_width of a point that is `offset` from its mean.

    Parameters:
        half_width (rad): half of the width of the interval.
        offset (rad): centre of the interval minus mean.
        variance (rad^2): variance of the variable.
    """
    scale = math.sqrt(2.0 * variance if variance > 1e-12 else 2e-12)
    return 0.5 * (math.erf((half_width - offset) / scale) + math.erf((half_width + offset) / scale))
