"""Tracks in, events of Cursor on Target out."""

from __future__ import annotations

import math
from collections.abc import Sequence

from av_reports.contacts import BearingTrack, Place, PositionTrack
from av_reports.cot.encoder import bearing_event, position_event, rig_event
from av_reports.identifiers import ObjectIds
from av_reports.settings import CotSettings

RIG_INTERVAL_S = 10.0  # between two events of the rig


class CotStage:
    """Events of the rig, of the bearings at its place, and of positions. Times are UTC in s since 1970.

    Parameters:
        settings: what is told.
    """

    def __init__(self, settings: CotSettings) -> None:
        self._settings = settings
        self._objects = ObjectIds()
        self._sent: dict[int, float] = {}
        self._rig_sent = -math.inf

    def on_tracks(self, tracks: Sequence[BearingTrack | PositionTrack], place: Place | None, now: float,
                  surveyed: bool = True) -> list[bytes]:
        """The events that are due.

        Parameters:
            tracks: the targets; bearings that do not count from true north are left out.
            place: where the rig stands; None while unknown, which leaves out all bearings.
            now (s): the time.
            surveyed: whether the place was given by a person, rather than measured.
        """
        events = []
        if place is not None and now - self._rig_sent >= RIG_INTERVAL_S:
            self._rig_sent = now
            events.append(rig_event(place, self._settings, now, surveyed))
        self._sent = {track.id: self._sent.get(track.id, -math.inf) for track in tracks}
        for track in tracks:
            uid = f'{self._settings.uid}.{self._objects.ulid(track.id, now)}'
            if now - self._sent[track.id] < self._interval:
                continue
            if isinstance(track, PositionTrack):
                events.append(position_event(track, uid, self._settings, now))
            elif track.north and place is not None:
                events.append(bearing_event(track, place, uid, self._settings, now))
            self._sent[track.id] = now
        return events

    @property
    def _interval(self) -> float:
        return 0.99 * self._settings.interval
