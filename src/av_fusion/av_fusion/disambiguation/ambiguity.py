"""Whether front and back of a target are resolved, and its possible directions while they are not."""

from __future__ import annotations

import math
from math import remainder, tau

from av_fusion.disambiguation.rotation import Candidate
from av_fusion.measurement.vectors import Rows, Vector, dot
from av_fusion.tracks.component import GaussianComponent
from av_fusion.tracks.mixture import GaussianMixture

RELEASE = 0.8  # probability below which what was resolved counts as unresolved again
OVERHEAD = math.sin(math.radians(60.0))  # vertical part of a direction in the body, above which front and back do not matter


def is_resolved(mixture: GaussianMixture, primary: GaussianComponent, front: float, attitude: Rows, confirm: float, before: bool
                ) -> bool:
    """Whether the direction is surely the primary one, and in one hemisphere; what was so before is kept for longer.

    Parameters:
        mixture, primary: density of the target, and the component of its direction.
        front: probability that it is in the front hemisphere.
        attitude: of the body in the world.
        confirm: probability from which it counts as resolved.
        before: whether it was resolved.
    """
    share = mixture.share_of(primary)
    overhead = abs(dot(primary.direction, (attitude[0][2], attitude[1][2], attitude[2][2]))) > OVERHEAD
    return min(share, 1.0 if overhead else max(front, 1.0 - front)) >= confirm or (before and share >= RELEASE)


def candidates(mixture: GaussianMixture, yaw: float, axis: Vector, confirm: float) -> list[Candidate]:
    """Possible directions of a target, level and seen from the rig's heading.

    Parameters:
        mixture: density of the target.
        yaw (rad): heading of the rig.
        axis: of the array, level and seen from the rig's heading.
        confirm: probability from which a direction counts as the only one.
    """
    found = []
    for c in mixture.likely:
        found.append(Candidate(remainder(c.azimuth - yaw, tau), float(c.covariance[0, 0]), c.across_rate,
                               float(c.covariance[2, 2]), c.weight, c.elevation))
    primary = mixture.primary()
    if primary is None or mixture.share_of(primary) < confirm:
        return found
    first = max(found, key=lambda candidate: candidate.weight)  # one direction close to the axis: either side
    mirrored = remainder(2.0 * math.atan2(axis[1], axis[0]) - first.azimuth, tau)
    either = first._replace(weight=0.5 * first.weight)
    return [either, either._replace(azimuth=mirrored, rate=-first.rate)]
