"""Whether front and back of a target are resolved, and its possible directions while they are not."""

from __future__ import annotations

import math
from math import remainder, tau

from av_fusion.disambiguation.rotation import Candidate
from av_fusion.measurement.vectors import Rows, Vector, dot, turned
from av_fusion.tracks.component import GaussianComponent
from av_fusion.tracks.mixture import GaussianMixture

RELEASE = 0.8  # probability below which what was resolved counts as unresolved again
OVERHEAD = math.sin(math.radians(60.0))  # vertical part of a direction in the body, above which front and back do not matter


class Ambiguity:
    """The ambiguity of one target, with hysteresis.

    Attributes:
        confirm: probability from which it counts as resolved.
        resolved: whether it is resolved.
        share: probability of the primary direction, as of the newest decision.

    Parameters:
        confirm: see the attribute.
    """

    def __init__(self, confirm: float) -> None:
        self.confirm = confirm
        self.resolved, self.share = False, 0.0

    def decide(self, mixture: GaussianMixture, primary: GaussianComponent, front: float, mirror_axis: Vector | None,
               attitude: Rows) -> None:
        """Decide whether the ambiguity is resolved.

        Parameters:
            mixture, primary: density of the target, and the component of its direction.
            front: probability that it is in the front hemisphere.
            mirror_axis: axis in the body about which directions of arrival are mirrored; None for none.
            attitude: of the body in the world.
        """
        axis = None if mirror_axis is None else turned(attitude, mirror_axis)
        self.share = mixture.share_of(primary, axis)
        overhead = abs(dot(primary.direction, (attitude[0][2], attitude[1][2], attitude[2][2]))) > OVERHEAD
        hemisphere = 1.0 if overhead else max(front, 1.0 - front)
        confirmed = min(self.share, hemisphere) >= self.confirm
        kept = self.resolved and self.share >= RELEASE
        self.resolved = confirmed or axis is None or kept

    def candidates(self, mixture: GaussianMixture, yaw: float, axis: Vector) -> list[Candidate]:
        """Possible directions of the target, level and seen from the rig's heading.

        Parameters:
            mixture: density of the target.
            yaw (rad): heading of the rig.
            axis: of the array, level and seen from the rig's heading.
        """
        candidates = []
        for c in mixture.components:
            (across, _), (_, up) = c.covariance[:2, :2].tolist()
            candidates.append(Candidate(remainder(c.azimuth - yaw, tau), across, c.across_rate, float(c.covariance[2, 2]),
                                        c.weight, c.elevation, up))
        if self.share < self.confirm:
            return candidates
        first = max(candidates, key=lambda candidate: candidate.weight)  # one direction close to the axis: either side
        mirrored = remainder(2.0 * math.atan2(axis[1], axis[0]) - first.azimuth, tau)
        either = first._replace(weight=0.5 * first.weight)
        return [either, either._replace(azimuth=mirrored, rate=-first.rate)]
