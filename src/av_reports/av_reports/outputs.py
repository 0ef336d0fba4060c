"""Where a situation is reported to, each with a connection of its own."""

from __future__ import annotations

from functools import partial
from typing import Protocol

from av_reports.cot.connection import CotAddress, connect
from av_reports.cot.stage import CotStage
from av_reports.link import Link
from av_reports.stage import Situation


class Output(Protocol):
    """Something that situations are reported to."""

    def report(self, situation: Situation) -> None:
        """Report a situation."""

    def problem(self) -> str:
        """What is wrong; empty for nothing."""

    def values(self) -> dict[str, object]:
        """What diagnostics tell."""

    def close(self) -> None:
        """End it."""


class CotOutput:
    """Events of Cursor on Target.

    Parameters:
        uid, callsign: of the rig, see `CotStage`.
        address: where to; one that can be used.
    """

    def __init__(self, uid: str, callsign: str, address: CotAddress) -> None:
        self._address = address
        self._stage = CotStage(uid, callsign)
        self._link = Link(partial(connect, address))
        self._placeless = False

    def report(self, situation: Situation) -> None:
        """Send the events that are due."""
        self._placeless = situation.place is None
        session = self._link.take().session
        if session:
            self._link.put(self._stage.on_tracks(situation.tracks, situation.place, situation.now), session)

    def problem(self) -> str:
        """Why nothing is reported."""
        if not self._link.take().session:
            return f'{self._address.url} is not connected: {self._link.problem or "no answer yet"}'
        return 'the place of the rig is not known: it needs the topic fix, or surveyed.latitude' if self._placeless else ''

    def values(self) -> dict[str, object]:
        """Numbers of what was sent."""
        return {'peer': self._address.url, **self._link.values()}

    def close(self) -> None:
        """End the connection."""
        self._link.close()
