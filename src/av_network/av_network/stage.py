"""The network stage: reports and places of the rigs in, targets with positions and cues for the rigs out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import Point, PointStamped
from numpy.typing import NDArray
from sensor_msgs.msg import NavSatFix, NavSatStatus
from std_msgs.msg import Header

from av_common.cue import CUE_SIGMA
from av_common.frames import MAP_FRAME
from av_common.freshness import FUTURE_S
from av_common.stamps import to_seconds, to_stamp
from av_interfaces.msg import RigPose, RigReport, WorldTrack, WorldTrackArray
from av_network.hypothesis_filter import largest_sigmas
from av_network.messages import PUBLISHED, check_age, direction_message, is_place, report_of, target_message
from av_network.network_target import TargetState
from av_network.report_queue import ReportQueue
from av_network.reporting import RECENT_S
from av_network.settings import Datum, RigSettings, to_enu
from av_network.tracker import NetworkTracker

NO_DATUM = Datum()
SURVEYED, ODOMETRY, FIX = 'surveyed', 'odometry', 'fix'
WAIT_S = 1.0  # see `ReportQueue`
CERTAIN = 4.0  # standard deviations of a clock's offset by which a stamp may be ahead of it
FIX_S = 10.0  # for which a place by satellites counts: ten messages of a receiver, one a second


@dataclass(frozen=True)
class RigPlace:
    """How a rig's place is known.

    Parameters:
        source: SURVEYED, ODOMETRY (relative to `position`) or FIX (NavSatFix, by the datum).
        position (3,) (m): ENU in the common frame.
        heading (rad): to be added to the azimuths of a rig without odometry, which believes that it faces east.
    """

    source: str
    position: NDArray[np.float64]
    heading: float = 0.0


@dataclass
class RigStatistics:
    """What came from a rig: bytes, newest capture time (s) by its clock, and reports before its place was known."""

    size: int = 0
    newest: float = -math.inf
    unplaced: int = 0


class NetworkStage:
    """Feeds a `NetworkTracker` from messages. Times are in s of the node's clock.

    Attributes:
        tracker: the tracker.
        queue: orders the reports.
        statistics: what came from each rig.

    Parameters:
        rigs: what is known of each.
        places: how the place of each is known.
        datum: of the origin.
    """

    def __init__(self, rigs: Sequence[RigSettings], places: Sequence[RigPlace], datum: Datum = NO_DATUM) -> None:
        self._datum = datum
        self.tracker = NetworkTracker(rigs)
        self.queue = ReportQueue(WAIT_S)
        self.statistics = {rig.name: RigStatistics() for rig in rigs}
        self._names = [rig.name for rig in rigs]
        self._places = dict(zip(self._names, places, strict=True))
        self._positions: dict[str, NDArray[np.float64]] = {
            name: place.position for name, place in self._places.items() if place.source == SURVEYED}
        self._fixed: dict[str, float] = {}  # when places by satellites arrived
        self._unresolved: dict[str, set[int]] = {name: set() for name in self._names}  # ids of the rig's tracks
        self._lone_ids: dict[tuple[int, int], int] = {}
        self._now = -math.inf

    def join(self, rig: RigSettings, place: RigPlace) -> None:
        """Take one more rig. Raises ValueError for a name that is known already.

        Parameters:
            rig: what is known of it.
            place: how its place is known.
        """
        self.tracker.join(rig)
        self._names.append(rig.name)
        self.statistics[rig.name], self._places[rig.name], self._unresolved[rig.name] = RigStatistics(), place, set()
        if place.source == SURVEYED:
            self._positions[rig.name] = place.position

    def on_report(self, rig: str, message: RigReport, size: int, arrival: float) -> None:
        """Take a rig's report. Raises ValueError for what cannot be used.

        Parameters:
            rig: the rig's name.
            message: directions of its targets, and its position by odometry.
            size (bytes): of the message.
            arrival (s): time of its arrival.
        """
        statistics, place = self.statistics[rig], self._places[rig]
        statistics.size += size
        stamp = to_seconds(message.header.stamp)
        index = self.tracker.rigs[rig]
        check_age(rig, arrival - self.tracker.corrected_time(index, stamp),
                  FUTURE_S + CERTAIN * self.tracker.calibration.known(index).clock_sigma)
        if place.source == ODOMETRY:
            self._positions.pop(rig, None)  # without odometry, its heading is not known either
            if is_place(message.position):
                self._positions[rig] = place.position + message.position
        if rig not in self._positions:
            statistics.unplaced += 1
            return
        report = report_of(message, rig, self._positions[rig], place.heading)
        statistics.newest = max(stamp, statistics.newest)
        self._unresolved[rig] = {one.id for one in message.directions if not one.resolved}
        self.queue.put(report, self.tracker.corrected_time(index, stamp))

    def on_fix(self, rig: str, message: NavSatFix, arrival: float) -> None:
        """Take a rig's position by satellites. Raises ValueError for one without a fix, or that is not on the globe.

        Parameters:
            rig: the rig's name.
            message: the position, which counts for FIX_S.
            arrival (s): time of its arrival.
        """
        if message.status.status < NavSatStatus.STATUS_FIX:
            raise ValueError(f'{rig} has no fix')
        self._positions[rig] = to_enu(Datum(message.latitude, message.longitude, message.altitude), self._datum)
        self._fixed[rig] = arrival

    def output(self, now: float) -> WorldTrackArray:
        """All targets at a time (s), after the reports that are complete by then."""
        if now < self._now - FUTURE_S:  # the clock was set back
            self._restart()
        self._now = now
        for rig in [rig for rig, arrival in self._fixed.items() if not 0.0 <= now - arrival <= FIX_S]:
            del self._fixed[rig], self._positions[rig]
        for report in self.queue.ready(now):
            self.tracker.use(report)
        tracks = [target_message(state, self._names) for state in self.tracker.states(now)
                  if state.existence >= PUBLISHED and (state.positioned or state.rigs)]
        tracks = sorted(tracks + self._lone(now), key=lambda track: track.id)
        datum = self._datum
        return WorldTrackArray(header=Header(stamp=to_stamp(now), frame_id=MAP_FRAME), latitude=datum.latitude,
                               longitude=datum.longitude, altitude=datum.altitude, tracks=tracks,
                               rigs=[self._pose(name) for name in sorted(self._names)])

    def cues(self, now: float) -> dict[str, PointStamped]:
        """For each rig the place of the nearest target that it does not report, or not on a certain side.

        The place is relative to the rig, and by its own heading. Others have measured the target within the last RECENT_S.

        Parameters:
            now (s): the present.
        """
        found = {}
        positioned = [state for state in self.tracker.states(now) if state.existence >= PUBLISHED and state.positioned]
        for index, name in enumerate(self._names):
            place = self._positions.get(name)
            if place is None:
                continue
            offsets = [state.mean[:3] - place for state in positioned if self._lacks(index, state) and _is_known(state, place)]
            if not offsets:
                continue
            x, y, z = map(float, offsets[int(np.argmin(np.linalg.norm(offsets, axis=1)))])
            turn = -self.tracker.calibration.known(index).heading - self._places[name].heading
            point = Point(x=x * math.cos(turn) - y * math.sin(turn), y=x * math.sin(turn) + y * math.cos(turn), z=z)
            found[name] = PointStamped(header=Header(stamp=to_stamp(now), frame_id=f'{name}/world'), point=point)
        return found

    def _lacks(self, rig: int, state: TargetState) -> bool:
        """Whether others have measured a target that a rig does not report, or not told from its mirror image."""
        ours = rig in state.rigs and state.target.members[rig].id not in self._unresolved[self._names[rig]]
        return not ours and any(other != rig for other in state.rigs)

    def _lone(self, now: float) -> list[WorldTrack]:
        """Targets that a single rig reports, in their direction."""
        found = []
        for key, (one, time) in self.tracker.unexplained.items():
            if now - time > RECENT_S or not one.sighting.resolved:
                continue
            if key not in self._lone_ids:
                self._lone_ids[key] = self.tracker.new_id()
            heading = self.tracker.calibration.known(one.rig).heading
            found.append(direction_message(self._lone_ids[key], self._names[one.rig], one, heading))
        self._lone_ids = {key: value for key, value in self._lone_ids.items() if key in self.tracker.unexplained}
        return found

    def _pose(self, name: str) -> RigPose:
        known = self.tracker.calibration.known(self.tracker.rigs[name])
        x, y, z = map(float, self._positions.get(name, np.full(3, math.nan)))
        return RigPose(name=name, position=Point(x=x, y=y, z=z), position_sigma=known.position_sigma,
                       heading_correction=known.heading + self._places[name].heading, heading_sigma=known.heading_sigma,
                       clock_offset=known.clock, clock_sigma=known.clock_sigma,
                       measured=to_stamp(max(self.statistics[name].newest, 0.0)))

    def _restart(self) -> None:
        self.queue.reset()
        self.tracker.reset()
        for each in self.statistics.values():
            each.newest = -math.inf


def _is_known(state: TargetState, place: NDArray[np.float64]) -> bool:
    """Whether the direction to a target from a place is precise enough to be told."""
    distance = float(np.linalg.norm(state.mean[:3] - place))
    return bool(largest_sigmas(state.covariance[None])[0] < CUE_SIGMA * distance)
