"""Estimates on which nothing may move, as what they rest on cannot be trusted."""

from __future__ import annotations

from av_common.track import Source, State, Targets, Track


def as_predictions(track: Track, targets: Targets, reason: str, sides: bool = True) -> tuple[Track, Targets]:
    """The estimates as predictions, on which nothing moves, for a reason: one of several publishers may be a forger.

    They state no measurement, as what comes by the other inputs is judged together with what the forger's left behind.

    Parameters:
        track: what is followed.
        targets: all targets.
        reason: what is published as such.
        sides: whether front and back may be told: not by a rig that is certainly not as described.
    """
    state = State.NONE if track.state == State.NONE else State.COASTING
    predicted = _unmeasured(track, sides)._replace(state=state, reason=reason, requested_rotation=0.0, look=None,
                                                   front_probability=track.front_probability if sides else 0.5)
    return predicted, targets._replace(targets=tuple(
        [target._replace(track=_unmeasured(target.track, sides)) for target in targets.targets]))


def _unmeasured(track: Track, sides: bool) -> Track:
    return track._replace(source=Source.NOTHING, measured=0.0, resolved=track.resolved and sides)
