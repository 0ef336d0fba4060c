"""The formula rig of the contracts: what its outputs are off by, and what holds for each of them."""

from __future__ import annotations

import math
from typing import Any

import formula_rig
import numpy as np
from formula_rig import START, Moment, azimuth_of, wrapped
from numpy.typing import NDArray

from av_common.stamps import to_seconds
from av_interfaces.msg import Bearing


def angle_between(a: NDArray, b: NDArray) -> float:
    """Angle of two unit vectors (3,) in degrees."""
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b)))


def rms(values: Any) -> float:
    """Root of the mean square; inf of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else math.inf


class FormulaRig(formula_rig.FormulaRig):
    """Each output has the form that the messages promise."""

    def __post_init__(self) -> None:
        super().__post_init__()
        taken = self.on_output

        def check(moment: Moment) -> None:
            check_form(moment, self.now)
            taken(moment)

        self.on_output = check

    def errors(self, after: float = 0.0, until: float = math.inf, folded: bool = False) -> NDArray:
        """Errors (n,) in degrees of the bearing's azimuth; `folded` takes either side of the pair's axis for right."""
        return np.array([self._error(math.degrees(moment.bearing.azimuth), moment.t, folded)
                         for moment in self.following(after, until)])

    def held(self, kind: str, after: float = 0.0, folded: bool = False) -> NDArray:
        """Errors (n,) in degrees of the newest measurement of a kind ('sound', 'sight') as it arrived, without any filter."""
        found = []
        for moment in self.following(after):
            azimuth = [known for arrived, what, known in self.measured if what == kind and arrived <= moment.t + 1e-6][-1]
            found.append(self._error(azimuth, moment.t, folded))
        return np.array(found)

    def _error(self, azimuth: float, t: float, folded: bool) -> float:
        truth = azimuth_of(self.body(t))
        both = wrapped(azimuth - truth), wrapped(180.0 - azimuth - truth)
        return min(both, key=abs) if folded else both[0]

    def normalised(self, after: float = 0.0, every: float = 0.5, folded: bool = False) -> NDArray:
        """Squared errors (n,) of the azimuth over the variances that the bearings state, one in `every` s."""
        found, due = [], after
        for moment, error in zip(self.following(after), self.errors(after, folded=folded), strict=True):
            if moment.t >= due:
                due = moment.t + every
                found.append(math.radians(error) ** 2 / moment.bearing.azimuth_variance)
        return np.array(found)


def check_form(moment: Moment, now: float) -> None:
    """What holds for every output, whatever goes in: as the message definitions say."""
    bearing, state, targets = moment.bearing, moment.state, moment.targets
    assert bearing.header == state.header == targets.header and abs(moment.t - now) < 1e-6
    assert bearing.state == state.state and len(state.reason) > 0
    assert 0.0 <= state.front_probability <= 1.0 and 0.5 <= bearing.hemisphere_probability <= 1.0
    assert to_seconds(bearing.measured) <= START + now + 0.1 + 1e-6     # what stamps may be ahead of the receiver's clock
    assert [track.id for track in targets.tracks] == sorted({track.id for track in targets.tracks})
    if bearing.state == Bearing.STATE_NONE:
        assert bearing.source == 0 and to_seconds(bearing.measured) == 0.0 and bearing.requested_rotation == 0.0
        return
    assert targets.selected in [track.id for track in targets.tracks] and targets.selected > 0
    for one in (bearing, *targets.tracks):
        values = (one.azimuth, one.elevation, one.azimuth_world, one.elevation_world, one.azimuth_world_rate,
                  one.elevation_world_rate)
        assert all(map(math.isfinite, values)) and -math.pi - 1e-6 < one.azimuth <= math.pi + 1e-6
        assert one.covariance_world[0] > 0.0 and one.covariance_world[3] > 0.0
    assert 0.0 < bearing.azimuth_variance < math.inf and bearing.elevation_variance > 0.0
