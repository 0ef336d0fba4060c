"""Prediction of a track that measurements no longer support."""

from __future__ import annotations

import math
from math import remainder, tau

from av_common.track import Source, Track
from av_fusion.filter.gaussian_component import share_within

RATE_DECAY_S = 1.0  # contradicting measurements may indicate a manoeuvre, after which the old rate is not valid


class CoastingTrack:
    """Keeps the last supported track and predicts it, at most for its previous duration.

    Parameters:
        longest (s): longest prediction.
    """

    def __init__(self, longest: float) -> None:
        self._longest = longest
        self._track: Track | None = None
        self._began = self._rate_variance = 0.0

    def keep(self, track: Track, rate_variance: float) -> None:
        """Keep a supported track.

        Parameters:
            track: the track.
            rate_variance (rad^2/s^2): variance of its azimuth rate.
        """
        if self._track is None:
            self._began = track.time
        self._track, self._rate_variance = track, rate_variance

    def predicted(self, time: float, yaw: float, acceleration_density: float) -> Track | None:
        """The kept track at `time`, with decaying rate, growing variance and unresolved ambiguity; None when it is too old.

        Parameters:
            time (s): time of the prediction.
            yaw (rad): yaw of the rig in the world at that time.
            acceleration_density (rad^2/s^3): spectral density of the target's angular acceleration.
        """
        last = self._track
        if last is None or not 0.0 <= (dt := time - last.time) < min(self._longest, last.time - self._began):
            self._track = None
            return None
        decay = math.exp(-dt / RATE_DECAY_S)
        azimuth_world = remainder(last.azimuth_world + last.azimuth_world_rate * RATE_DECAY_S * (1.0 - decay), tau)
        azimuth = remainder(azimuth_world - yaw, tau)
        variance = last.azimuth_variance + dt**2 * self._rate_variance + acceleration_density * dt**3 / 3.0
        return last._replace(
            time=time, source=Source.NOTHING, azimuth=azimuth, azimuth_world=azimuth_world, azimuth_variance=variance,
            azimuth_world_rate=last.azimuth_world_rate * decay, resolved=False, requested_rotation=0.0,
            front_probability=share_within(0.5 * math.pi, azimuth, variance), sound_weight=0.0, sight_weight=0.0)
