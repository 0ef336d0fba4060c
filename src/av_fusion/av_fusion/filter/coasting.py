"""A track in doubt is carried on for a while: what is heard and seen fits it no longer, and nothing better is known."""

from __future__ import annotations

import math
from math import remainder, tau

from av_common.track import Source, Track
from av_fusion.filter.gaussian_component import share_within

SLOWING_S = 1.0  # what does not fit may have changed the course already: by and by it counts no more


class LastKnown:
    """Remembers the last track that was believed and says where it would be by now, for `longest` s or as long as it lasted."""

    def __init__(self, longest: float) -> None:
        self._longest = longest
        self._track: Track | None = None
        self._began = self._rate_variance = 0.0

    def keep(self, track: Track, rate_variance: float) -> None:
        """A track that is believed, and the variance of its rate (rad^2/s^2)."""
        if self._track is None:
            self._began = track.time
        self._track, self._rate_variance = track, rate_variance

    def carried(self, time: float, yaw: float, acceleration_density: float) -> Track | None:
        """The track at `time` from a rig at `yaw` (world, rad): slower, less sure, front and back open; None for too old.

        `acceleration_density` (rad^2/s^3) is how it may have turned since.
        """
        last = self._track
        if last is None or not 0.0 <= (dt := time - last.time) < min(self._longest, last.time - self._began):
            self._track = None
            return None
        slowed = math.exp(-dt / SLOWING_S)
        azimuth_world = remainder(last.azimuth_world + last.azimuth_world_rate * SLOWING_S * (1.0 - slowed), tau)
        azimuth = remainder(azimuth_world - yaw, tau)
        variance = last.azimuth_variance + dt**2 * self._rate_variance + acceleration_density * dt**3 / 3.0
        return last._replace(
            time=time, source=Source.NOTHING, azimuth=azimuth, azimuth_world=azimuth_world, azimuth_variance=variance,
            azimuth_world_rate=last.azimuth_world_rate * slowed, resolved=False, requested_rotation=0.0,
            front_probability=share_within(0.5 * math.pi, azimuth, variance), sound_weight=0.0, sight_weight=0.0)
