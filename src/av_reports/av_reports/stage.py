"""Messages of the rig in, what is to be reported out."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from sensor_msgs.msg import NavSatFix

from av_common.freshness import Instant
from av_interfaces.msg import Bearing, FusionState, TrackArray, WorldTrackArray
from av_reports.contacts import BearingTrack, Place, PositionTrack, is_reported, later
from av_reports.messages import bearing_tracks, place_of_fix, position_tracks

MOST_TRACKS = 100  # those that are most likely there
SILENT_S = 2.0  # without a message of the tracker for this long it is missing
PLACE_S = 10.0  # for which a place of the receiver counts: ten of its messages, one a second
NO_HEADING = ("the rig's heading is not known: it needs odometry, or surveyed.heading_deg at a surveyed place, or north "
              'false, with which directions count from ahead')


class Situation(NamedTuple):
    """What is reported at a moment.

    Parameters:
        stamped: the targets by the clock of their stamps.
        place: where the rig stands; None while unknown.
        problems: what is wrong, in words.
        silent: whether the tracker says nothing at all.
        now (s): UTC since 1970.
        to_utc (s): what is to be added to the stamps of the targets for UTC.
    """

    stamped: tuple[BearingTrack | PositionTrack, ...]
    place: Place | None
    problems: tuple[str, ...]
    silent: bool
    now: float
    to_utc: float = 0.0

    @property
    def tracks(self) -> tuple[BearingTrack | PositionTrack, ...]:
        """The targets by UTC."""
        return tuple(later(track, self.to_utc) for track in self.stamped)


@dataclass(frozen=True)
class ReportSettings:
    """What is reported.

    Parameters:
        only_drones: what is probably no drone is left out.
        positions: positions of a network of rigs, instead of bearings of this one.
        north: bearings count from true north; otherwise from the rig's forward direction.
        place: where the rig stands, surveyed; None for that of its receiver of satellite navigation.
        heading (rad): surveyed heading of the rig's forward direction, clockwise from true north; it counts while the rig's
            attitude is not known. None for none.
    """

    only_drones: bool = True
    positions: bool = False
    north: bool = True
    place: Place | None = None
    heading: float | None = None


class ReportStage:
    """Keeps the newest message of each kind, and says what of it is to be reported.

    Times of arrival are on a steady clock, for ages, and in UTC, for what is told.

    Attributes:
        settings: what is reported; may be replaced.

    Parameters:
        settings: what is reported.
    """

    def __init__(self, settings: ReportSettings) -> None:
        self.settings = settings
        self._tracks: tuple[BearingTrack | PositionTrack, ...] = ()
        self._attitude_known = False
        self._missing: tuple[str, ...] = ()
        self._fix: Place | None = None
        self._fix_arrived = self._tracks_arrived = -math.inf
        self._to_utc = 0.0

    def on_bearing(self, message: Bearing) -> None:
        """Note whether the rig's attitude is known."""
        self._attitude_known = message.attitude_known

    def on_state(self, message: FusionState) -> None:
        """Note what the tracker misses."""
        self._missing = tuple(message.missing)

    def on_fix(self, message: NavSatFix, now: Instant) -> None:
        """Note where the rig is. Raises ValueError for a message without a fix.

        Parameters:
            message: of a receiver of satellite navigation.
            now: its arrival.
        """
        self._fix, self._fix_arrived = place_of_fix(message), now.steady

    def on_targets(self, message: TrackArray, now: Instant, to_utc: float) -> None:
        """Note the targets of this rig. Raises ValueError for stamps that cannot be used.

        Parameters:
            message: the targets.
            now: its arrival.
            to_utc (s): what is to be added to ROS time for UTC.
        """
        if not self.settings.positions:
            heading = None if self._attitude_known else self.settings.heading
            self._take(() if self._is_lost else bearing_tracks(message, heading, self.settings.north), now, to_utc)

    def on_network_tracks(self, message: WorldTrackArray, now: Instant, to_utc: float) -> None:
        """Note the targets of a network. Raises ValueError for stamps and frames that cannot be used.

        Parameters:
            message: the targets.
            now: its arrival.
            to_utc (s): what is to be added to ROS time for UTC.
        """
        if self.settings.positions:
            self._take(position_tracks(message), now, to_utc)

    def _take(self, tracks: Iterable[BearingTrack | PositionTrack], now: Instant, to_utc: float) -> None:
        self._tracks, self._tracks_arrived, self._to_utc = tuple(tracks), now.steady, to_utc

    def situation(self, now: Instant, to_utc: float) -> Situation:
        """What is to be reported.

        Parameters:
            now: the time.
            to_utc (s): what is to be added to ROS time for UTC.
        """
        utc = now.ros + to_utc
        silent = now.steady - self._tracks_arrived > SILENT_S
        taken = [] if silent else [track for track in self._tracks
                                   if is_reported(later(track, self._to_utc), utc, self.settings.only_drones)]
        taken = sorted(taken, key=lambda track: -track.existence)[:MOST_TRACKS]
        return Situation(tuple(taken), self._place(now), tuple(self._problems(silent)), silent, utc, self._to_utc)

    def _place(self, now: Instant) -> Place | None:
        if self.settings.place is not None:
            return self.settings.place
        return self._fix if now.steady - self._fix_arrived <= PLACE_S else None

    def _problems(self, silent: bool) -> list[str]:
        if silent:
            return ['no targets arrive']
        return [*([NO_HEADING] if self._is_lost else []), *(f'no {name}' for name in self._missing)]

    @property
    def _is_lost(self) -> bool:
        """Whether the heading is needed and not known."""
        settings = self.settings
        return not settings.positions and settings.north and settings.heading is None and not self._attitude_known
