"""The network stage: reports and places of the rigs in, targets with positions and cues for the rigs out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from geometry_msgs.msg import Point, PointStamped
from numpy.typing import NDArray
from sensor_msgs.msg import NavSatFix, NavSatStatus
from std_msgs.msg import Header

from av_common.cue import CUE_SIGMA
from av_common.frames import MAP_FRAME
from av_common.freshness import FUTURE_S
from av_common.geodesy import geodetic_to_enu
from av_common.stamps import to_seconds, to_stamp
from av_interfaces.msg import RigPose, RigReport, WorldTrack, WorldTrackArray
from av_network.hypothesis_filter import largest_sigmas
from av_network.messages import MOST_POSITION_M, PUBLISHED, check_age, direction_message, is_place, report_of, target_message
from av_network.network_target import SUPPORT_S, TargetState
from av_network.observation import GATE, RigSettings
from av_network.report_queue import ReportQueue
from av_network.tracker import NetworkTracker

NO_DATUM = (math.nan,) * 3
SURVEYED, ODOMETRY, FIX = 'surveyed', 'odometry', 'fix'
WAIT_S = 1.0  # see `ReportQueue`
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
class RigInput:
    """What came from a rig.

    Parameters:
        place: how its place is known.
        position (3,) (m): where it is, ENU; None while unknown.
        fixed (s): when its place by satellites arrived.
        unresolved: ids of its tracks that are not known from their mirror images.
        newest (s): capture time by its clock.
        unplaced: number of reports before its place was known.
    """

    place: RigPlace
    position: NDArray[np.float64] | None
    fixed: float = -math.inf
    unresolved: set[int] = field(default_factory=set)
    newest: float = -math.inf
    unplaced: int = 0


class NetworkStage:
    """Feeds a `NetworkTracker` from messages. Times are in s of the node's clock.

    Attributes:
        tracker: the tracker.
        queue: orders the reports.
        rigs: what came from each, by its name, in the order of the tracker.

    Parameters:
        datum: latitude, longitude (deg) and altitude above the ellipsoid (m) of the origin; NaN where they are not known.
    """

    def __init__(self, datum: tuple[float, float, float] = NO_DATUM) -> None:
        self._datum = datum
        self.tracker, self.queue = NetworkTracker(()), ReportQueue(WAIT_S)
        self.rigs: dict[str, RigInput] = {}
        self._lone_ids: dict[tuple[int, int], int] = {}
        self._now = -math.inf

    def join(self, rig: RigSettings, place: RigPlace) -> None:
        """Take one more rig. Raises ValueError for a name that is known already.

        Parameters:
            rig: what is known of it.
            place: how its place is known.
        """
        self.tracker.join(rig)
        self.rigs[rig.name] = RigInput(place, place.position if place.source == SURVEYED else None)

    def on_report(self, rig: str, message: RigReport, arrival: float) -> None:
        """Take a rig's report. Raises ValueError for what cannot be used.

        Parameters:
            rig: the rig's name.
            message: directions of its targets, and its position by odometry.
            arrival (s): time of its arrival.
        """
        found = self.rigs[rig]
        stamp = to_seconds(message.header.stamp)
        index = self.tracker.rigs[rig]
        check_age(rig, arrival - self.tracker.corrected_time(index, stamp),
                  FUTURE_S + math.sqrt(GATE) * self.tracker.calibration.known(index).clock_sigma)
        if found.place.source == ODOMETRY:  # without it, the heading is not known either
            found.position = found.place.position + message.position if is_place(message.position) else None
        if found.position is None:
            found.unplaced += 1
            return
        report = report_of(message, rig, found.position, found.place.heading)
        found.newest = max(stamp, found.newest)
        found.unresolved = {one.id for one in message.directions if not one.resolved}
        self.queue.put(report, self.tracker.corrected_time(index, stamp))

    def on_fix(self, rig: str, message: NavSatFix, arrival: float) -> None:
        """Take a rig's position by satellites. Raises ValueError for one without a fix, or that is not on the globe.

        Parameters:
            rig: the rig's name.
            message: the position, which counts for FIX_S.
            arrival (s): time of its arrival.
        """
        place = (message.latitude, message.longitude, message.altitude)
        if message.status.status < NavSatStatus.STATUS_FIX or not np.all(np.abs(place) <= (90.0, 180.0, MOST_POSITION_M)):
            raise ValueError(f'{rig} has no fix: status {message.status.status}, {place}')
        self.rigs[rig].position, self.rigs[rig].fixed = geodetic_to_enu(place, self._datum), arrival

    def output(self, now: float) -> WorldTrackArray:
        """All targets at a time (s), after the reports that are complete by then."""
        if now < self._now - FUTURE_S:  # the clock was set back
            self.queue = ReportQueue(WAIT_S)
            self.tracker.reset()
            for each in self.rigs.values():
                each.newest = -math.inf
        self._now = now
        for each in self.rigs.values():
            if each.place.source == FIX and not 0.0 <= now - each.fixed <= FIX_S:
                each.position = None
        for report in self.queue.ready(now):
            self.tracker.use(report)
        names = list(self.rigs)
        tracks = [target_message(state, names) for state in self.tracker.states(now)
                  if state.existence >= PUBLISHED and (state.positioned or state.rigs)]
        tracks = sorted(tracks + self._lone(now), key=lambda track: track.id)
        latitude, longitude, altitude = self._datum
        return WorldTrackArray(header=Header(stamp=to_stamp(now), frame_id=MAP_FRAME), latitude=latitude, longitude=longitude,
                               altitude=altitude, tracks=tracks, rigs=[self._pose(name) for name in sorted(names)])

    def cues(self, now: float) -> dict[str, PointStamped]:
        """For each rig the place of the nearest target that it does not report, or not on a certain side.

        The place is relative to the rig, and by its own heading. Others have measured the target within the last SUPPORT_S.

        Parameters:
            now (s): the present.
        """
        found = {}
        positioned = [state for state in self.tracker.states(now) if state.existence >= PUBLISHED and state.positioned]
        for index, (name, rig) in enumerate(self.rigs.items()):
            place = rig.position
            if place is None:
                continue
            offsets = [state.mean[:3] - place for state in positioned
                       if _lacks(index, rig.unresolved, state) and _is_known(state, place)]
            if not offsets:
                continue
            x, y, z = map(float, offsets[int(np.argmin(np.linalg.norm(offsets, axis=1)))])
            turn = -self.tracker.calibration.known(index).heading - rig.place.heading
            point = Point(x=x * math.cos(turn) - y * math.sin(turn), y=x * math.sin(turn) + y * math.cos(turn), z=z)
            found[name] = PointStamped(header=Header(stamp=to_stamp(now), frame_id=f'{name}/world'), point=point)
        return found

    def _lone(self, now: float) -> list[WorldTrack]:
        """Targets that a single rig reports, in their direction."""
        found, names = [], list(self.rigs)
        for key, (one, time) in self.tracker.unexplained.items():
            if now - time > SUPPORT_S or not one.sighting.resolved:
                continue
            if key not in self._lone_ids:
                self._lone_ids[key] = self.tracker.new_id()
            heading = self.tracker.calibration.known(one.rig).heading
            found.append(direction_message(self._lone_ids[key], names[one.rig], one, heading))
        self._lone_ids = {key: value for key, value in self._lone_ids.items() if key in self.tracker.unexplained}
        return found

    def _pose(self, name: str) -> RigPose:
        known, rig = self.tracker.calibration.known(self.tracker.rigs[name]), self.rigs[name]
        x, y, z = map(float, np.full(3, math.nan) if rig.position is None else rig.position)
        return RigPose(name=name, position=Point(x=x, y=y, z=z), position_sigma=known.position_sigma,
                       heading_correction=known.heading + rig.place.heading, heading_sigma=known.heading_sigma,
                       clock_offset=known.clock, clock_sigma=known.clock_sigma,
                       measured=to_stamp(max(rig.newest, 0.0)))


def _lacks(rig: int, unresolved: set[int], state: TargetState) -> bool:
    """Whether others have measured a target that a rig does not report, or not told from its mirror image."""
    ours = rig in state.rigs and state.target.members[rig].id not in unresolved
    return not ours and any(other != rig for other in state.rigs)


def _is_known(state: TargetState, place: NDArray[np.float64]) -> bool:
    """Whether the direction to a target from a place is precise enough to be told."""
    distance = float(np.linalg.norm(state.mean[:3] - place))
    return bool(largest_sigmas(state.covariance[None])[0] < CUE_SIGMA * distance)
