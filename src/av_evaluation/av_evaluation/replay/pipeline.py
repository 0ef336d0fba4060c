"""The stages of the rig one after the other."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

from av_bags import topics as names
from av_common.track import Track
from av_common.track_messages import track_of_bearing
from av_evaluation.replay.messages import MessageMaker
from av_evaluation.replay.run_recorder import Journal
from av_evaluation.replay.stages import Fusing, Hearing, Output, Pointing, Seeing
from av_fusion.measurement.converter import Senses


class Chain:
    """Takes what the bag holds by the rig's names of its topics, each with the time at which it came.

    `tell` is given what follows, as the parts of an `Output`. A stage that is None is not computed: what it would say is
    expected from the bag. Times must not fall.
    """

    def __init__(self, senses: Senses, journal: Journal, hearing: Hearing | None, seeing: Seeing | None,
                 fusing: Fusing | None, pointing: Pointing | None, make: MessageMaker,
                 tell: Callable[[str, float, Any], None]) -> None:
        self._senses, self._journal, self._make, self._tell = senses, journal, make, tell
        self._hearing, self._seeing, self._fusing, self._pointing = hearing, seeing, fusing, pointing

    @property
    def due(self) -> float:
        """When something is said next, even if nothing comes."""
        return math.inf if self._fusing is None else self._fusing.due

    def wait(self, now: float) -> None:
        """Nothing came until `now`."""
        for track in self._fusing.wait(now) if self._fusing is not None else ():
            self._say(track)

    def move(self, odometry: Any, now: float) -> None:
        """The rig's own motion."""
        if self._fusing is not None:
            self._fusing.move(odometry, now)

    def take(self, name: str, content: Any, now: float) -> None:
        """A message, or what it means."""
        if name == names.AUDIO and self._hearing is not None:
            self._fuse(self._hearing.take(content, now))
        elif name == names.MOTORS and self._hearing is not None:
            self._hearing.turn(content)
        elif name == names.IMAGE and self._seeing is not None:
            self._fuse(self._seeing.take(content, now))
        elif self._fusing is not None:
            track = self._fusing.take(name, content, now)
            if track is not None:
                self._say(track)
        else:
            self._follow(name, content, now)

    def _follow(self, name: str, content: Any, now: float) -> None:
        """Take a message when the bearings are recorded ones."""
        if name == names.DOA:
            self._journal.hear(self._senses.sounds(content), now)
        elif name == names.DETECTIONS:
            look = self._senses.look(content)
            if look is not None:
                self._journal.see(look, content, now)
        elif name == names.BEARING:
            track = track_of_bearing(content)
            self._journal.follow(track, now)
            if self._pointing is not None:
                self._tell(*self._pointing.take(track, now))

    def _fuse(self, outputs: Iterable[Output]) -> None:
        """Take what the senses say, read as its reader will find it: with the precision of its fields."""
        for name, now, data in outputs:
            self._tell(name, now, data)
            self.take(name, self._make.deserialise(name, data), now)

    def _say(self, track: Track) -> None:
        """Tell of a track and the command that follows."""
        self._tell(names.STATE, track.time, (track, self._fusing.missing(track.time)))
        self._tell(names.BEARING, track.time, track)
        if self._pointing is not None:
            self._tell(*self._pointing.take(track, track.time))
