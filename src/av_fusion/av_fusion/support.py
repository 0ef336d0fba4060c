"""Which sensors a track is stated to rest on: none whose input has two sources, one of which may be forged."""

from __future__ import annotations

from av_common.track import Source, State, Targets, Track

DOUBTFUL = 'an input has two sources: the track is continued, and counts as a prediction'


def without_support(track: Track, doubtful: Source, trusted: float) -> Track:
    """The track, supported by the other sensors.

    Parameters:
        track: the track.
        doubtful: sensors whose newest messages may be of a second source.
        trusted (s): newest stamp of the sensors from before that.
    """
    source = track.source & ~doubtful
    lost = ((track.state == State.VISUAL_ACTIVE and doubtful & Source.SIGHT)
            or (track.state == State.ACOUSTIC_ACTIVE and doubtful & Source.SOUND))
    state, reason = track.state, track.reason
    if lost:
        state = (State.VISUAL_ACTIVE if source & Source.SIGHT else State.ACOUSTIC_ACTIVE if source & Source.SOUND
                 else State.COASTING)
        reason = DOUBTFUL
    return track._replace(state=state, reason=reason, source=source, measured=min(track.measured, max(trusted, 0.0)))


def targets_without_support(targets: Targets, doubtful: Source, heard: float, seen: float) -> Targets:
    """The same for all targets.

    Parameters:
        targets: the targets.
        doubtful: sensors whose newest messages may be of a second source.
        heard, seen (s): newest stamps of directions of arrival and of images from before that.
    """
    return targets._replace(targets=tuple(target._replace(
        track=without_support(target.track, doubtful, max(heard, seen)), heard=min(target.heard, heard),
        seen=min(target.seen, seen)) for target in targets.targets))
