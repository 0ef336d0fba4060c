"""The stages of the rig one after the other."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

from av_fusion.bags import topics as names
from av_fusion.bags.journal import Journal, track_of
from av_fusion.bags.stages import Fusing, Hearing, Output, Pointing, Seeing
from av_fusion.poses import Pose
from av_fusion.senses import Senses


class Chain:
    """Takes messages by the rig's names of their topics, each with the time at which it came, and gives what follows.

    A stage that is None is not computed: what it would say is expected among the messages. Times must not fall.
    """

    def __init__(self, senses: Senses, journal: Journal, hearing: Hearing | None, seeing: Seeing | None,
                 fusing: Fusing | None, pointing: Pointing | None) -> None:
        self._senses, self._journal = senses, journal
        self._hearing, self._seeing, self._fusing, self._pointing = hearing, seeing, fusing, pointing
        self._state: Any = None

    @property
    def due(self) -> float:
        """When something is said next, even if nothing comes."""
        return math.inf if self._fusing is None else self._fusing.due

    def wait(self, now: float) -> Iterable[Output]:
        """What is said until `now` though nothing came."""
        return () if self._fusing is None else self._point(self._fusing.wait(now))

    def move(self, pose: Pose, now: float) -> None:
        """The rig's own motion."""
        if self._fusing is not None:
            self._fusing.move(pose, now)

    def take(self, name: str, message: Any, now: float) -> Iterator[Output]:
        """What a message leads to."""
        if name == names.AUDIO and self._hearing is not None:
            yield from self._fuse(self._hearing.take(message, now))
        elif name == names.MOTORS and self._hearing is not None:
            self._hearing.turn(message)
        elif name == names.IMAGE and self._seeing is not None:
            yield from self._fuse(self._seeing.take(message, now))
        elif self._fusing is not None:
            yield from self._point(self._fusing.take(name, message, now))
        else:
            yield from self._follow(name, message, now)

    def _follow(self, name: str, message: Any, now: float) -> Iterator[Output]:
        """What a message leads to when the bearings are recorded ones."""
        if name == names.DOA:
            self._journal.hear(self._senses.sounds(message), now)
        elif name == names.DETECTIONS:
            look = self._senses.look(message)
            if look is not None:
                self._journal.see(look, message, now)
        elif name == names.STATE:
            self._state = message
        elif name == names.BEARING:
            track = track_of(message, self._state)
            self._journal.follow(track, now)
            if self._pointing is not None:
                yield self._pointing.take(track, now)

    def _fuse(self, outputs: Iterable[Output]) -> Iterator[Output]:
        """Each output of the senses, and what it leads to."""
        for name, now, message in outputs:
            yield name, now, message
            yield from self.take(name, message, now)

    def _point(self, outputs: Iterable[Output]) -> Iterator[Output]:
        """Each output of the fusion, and the commands that follow."""
        for name, now, message in outputs:
            yield name, now, message
            if name == names.BEARING and self._pointing is not None:
                yield self._pointing.take(message, now)
