"""Multi-target trackers on the same simulated measurements: GOSPA, identity switches and cost."""

from __future__ import annotations

import math
import time as wall
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from av_evaluation.experiments.measurement_simulation import Scan
from av_evaluation.metrics.tracks import TrackComparison, TrackFigures
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.measurement.vectors import direction
from av_fusion.tracks.filter import MultiBernoulliFilter
from av_fusion.tracks.settings import FilterSettings


class Peer(Protocol):
    """A multi-target tracker."""

    def use(self, scan: Scan) -> dict[int, NDArray[np.float64]]:
        """Use a scan; unit vectors (3,) to the targets in the body's frame, by the name of each."""

    def identity(self) -> float:
        """Least probability that a track still follows the target that was given its name; NaN where it is not known."""


class OwnFilter:
    """The rig's filter as a `Peer`, for a rig that stands still.

    Attributes:
        filter: the filter.

    Parameters:
        settings: see `FilterSettings`.
    """

    def __init__(self, settings: FilterSettings | None = None) -> None:
        self._settings = settings or FilterSettings()
        self._motion = RigMotion()
        self.filter = MultiBernoulliFilter(self._settings, self._motion)

    def use(self, scan: Scan) -> dict[int, NDArray[np.float64]]:
        """See `Peer`."""
        self._motion.add(Pose.level(scan.time, 0.0))
        if scan.doas is not None:
            self.filter.update_sound(scan.time, scan.doas)
        if scan.image is not None:
            self.filter.update_image(scan.time, scan.image)
        found = {}
        for track in self.filter.tracks:
            primary = track.mixture.primary()
            if track.existence >= self._settings.confirmed and primary is not None and not track.kind.drone < 0.5:
                found[track.id] = np.array(direction(primary.azimuth, primary.elevation))
        return found

    def identity(self) -> float:
        """See `Peer`."""
        return min((track.identity for track in self.filter.tracks if track.existence >= self._settings.confirmed),
                   default=math.nan)


@dataclass(frozen=True)
class MultiTargetFigures:
    """Figures of one tracker in one run.

    Parameters:
        tracks: see `TrackFigures`.
        identity: see `Peer`, at last.
        percent: processor time over the duration of the run, in percent.
    """

    tracks: TrackFigures
    identity: float
    percent: float


def figures_of(peer: Peer, scans: Iterable[Scan]) -> MultiTargetFigures:
    """Run a tracker on the scans of a run.

    Parameters:
        peer: the tracker.
        scans: measurements and truth.
    """
    comparison, used, last = TrackComparison(), 0.0, 0.0
    for scan in scans:
        begun = wall.process_time()
        tracks = peer.use(scan)
        used, last = used + wall.process_time() - begun, scan.time
        comparison.add(scan.truth, tracks)
    return MultiTargetFigures(comparison.figures(), peer.identity(), 100.0 * used / max(last, 1e-9))
