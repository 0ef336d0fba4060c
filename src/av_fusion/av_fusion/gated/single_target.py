"""The target of a tracker that knows only one, with an id like one of several."""

from __future__ import annotations

from av_common.track import Source, State, Target, Targets, Track


class SingleTarget:
    """Names the target. Each track that begins after one has ended gets a new id."""

    def __init__(self) -> None:
        self._id = 0
        self._tracked = False
        self._heard = self._seen = float('-inf')

    def targets(self, track: Track, existence: float = 1.0) -> Targets:
        """The target of an estimate, if there is one.

        Parameters:
            track: the newest estimate.
            existence: probability that there is such a target.
        """
        begins, self._tracked = track.state != State.NONE and not self._tracked, track.state != State.NONE
        if not self._tracked:
            return Targets(track.time)
        if begins:
            self._id, self._heard, self._seen = self._id + 1, float('-inf'), float('-inf')
        if track.source & Source.SOUND:
            self._heard = track.measured
        if track.source & Source.SIGHT:
            self._seen = track.measured
        return Targets(track.time, (Target(self._id, existence, track, heard=self._heard, seen=self._seen),), self._id)

    def select(self, identifier: int) -> None:
        """Accept the only target. Raises ValueError for another id."""
        if identifier not in (0, self._id if self._tracked else 0):
            raise ValueError(f'target {identifier} is not tracked')
