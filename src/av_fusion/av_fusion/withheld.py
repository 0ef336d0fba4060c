"""Estimates on which nothing may move, as what they rest on cannot be trusted."""

from __future__ import annotations

from av_common.track import Source, State, Targets, Track
from av_fusion.consistency.events import Fault


def as_predictions(track: Track, targets: Targets, reason: str) -> tuple[Track, Targets]:
    """The estimates as predictions, on which nothing moves, for a reason: one of several publishers may be a forger.

    They state no measurement, as what comes by the other inputs is judged together with what the forger's left behind.

    Parameters:
        track: what is followed.
        targets: all targets.
        reason: what is published as such.
    """
    state = State.NONE if track.state == State.NONE else State.COASTING
    predicted = track._replace(state=state, source=Source.NOTHING, measured=0.0, reason=reason, requested_rotation=0.0,
                               look=None)
    return predicted, targets._replace(targets=tuple(
        [target._replace(track=target.track._replace(source=Source.NOTHING, measured=0.0)) for target in targets.targets]))


def contradicted(track: Track, targets: Targets, fault: Fault) -> tuple[Track, Targets]:
    """The estimates of a rig that is certainly not as described: nothing moves on them.

    Parameters:
        track: what is followed.
        targets: all targets.
        fault: what is wrong.
    """
    uncertain = track._replace(front_probability=0.5, resolved=False)
    unresolved = targets._replace(targets=tuple(
        [target._replace(track=target.track._replace(resolved=False)) for target in targets.targets]))
    return as_predictions(uncertain, unresolved, f'the rig is not as described: {fault.text}')
