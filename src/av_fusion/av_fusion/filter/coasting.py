"""Prediction of a track that measurements no longer support."""

from __future__ import annotations

import math
from dataclasses import replace

from av_common.track import Source, Track
from av_fusion.filter.gaussian_component import GaussianComponent
from av_fusion.filter.gaussian_mixture import front_share
from av_fusion.filter.motion_model import MotionModel
from av_fusion.filter.world_track import placed
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import Rows

RATE_DECAY_S = 1.0  # contradicting measurements may indicate a manoeuvre, after which the old rate is not valid


class CoastingTrack:
    """Keeps the last supported track and predicts it, at most for its previous duration.

    Parameters:
        longest (s): longest prediction.
        model: motion of targets.
    """

    def __init__(self, longest: float, model: MotionModel) -> None:
        self._longest, self._model = longest, model
        self._track: Track | None = None
        self._began = 0.0

    def keep(self, track: Track, component: GaussianComponent) -> None:
        """Keep a supported track.

        Parameters:
            track: the track.
            component: the component of the posterior that it was made of, at its time.
        """
        if self._track is None:
            self._began = track.time
        self._track, self._component = track, component

    def turn_world(self, rows: Rows) -> None:
        """Turn the kept track with the world, where the rig's attitude was corrected."""
        if self._track is not None:
            self._component.turn_world(rows)

    def predicted(self, time: float, motion: RigMotion, noise_scale: float) -> Track | None:
        """The kept track at `time`, with decaying rate, growing variance and unresolved ambiguity; None when it is too old.

        Parameters:
            time (s): time of the prediction.
            motion: attitude and path of the rig.
            noise_scale: factor of the acceleration density.
        """
        last = self._track
        if last is None or not 0.0 <= (dt := time - last.time) < min(self._longest, last.time - self._began):
            self._track = None
            return None
        decay = math.exp(-dt / RATE_DECAY_S)
        shortened = RATE_DECAY_S * (1.0 - decay) / dt if dt > 1e-6 else 1.0
        component = self._component
        later = replace(component, across_rate=shortened * component.across_rate, up_rate=shortened * component.up_rate
                        ).predicted(dt, self._model, noise_scale, motion.moved(last.time, time))
        later.across_rate, later.up_rate = decay * component.across_rate, decay * component.up_rate
        return placed(last._replace(time=time), later, motion)._replace(
            source=Source.NOTHING, resolved=False, requested_rotation=0.0, look=None,
            front_probability=front_share(later, motion.attitude(time)), sound_weight=0.0, sight_weight=0.0)
