"""Where a component of a track is, in the world and in the body, as fields of a track."""

from __future__ import annotations

import math

from av_common.track import Track
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.tracks.component import BodyDirection, GaussianComponent

LEAST_LEVEL = 0.05  # cosine of an elevation; closer to the zenith the rate of the azimuth is bounded
KNOWN_RANGE = 2.0  # inverse range over its standard deviation from which a range is published


def placed(track: Track, component: GaussianComponent, found: BodyDirection, motion: RigMotion) -> Track:
    """A track with the direction, rates and range of a component at the track's time.

    Parameters:
        track: all but these.
        component: the component at that time.
        found: its direction in the body.
        motion: attitude and path of the rig.
    """
    across_rate, up_rate = component.rates(motion.velocity(track.time))
    (hh, hv), (_, vv) = component.covariance[:2, :2].tolist()
    inverse, variance = component.inverse_range, float(component.covariance[4, 4])
    known = inverse > KNOWN_RANGE * math.sqrt(variance)
    return track._replace(
        azimuth=found.azimuth, elevation=found.elevation, azimuth_variance=found.azimuth_variance,
        elevation_variance=found.elevation_variance if component.elevation_measured else math.inf,
        azimuth_world=component.azimuth, azimuth_world_rate=across_rate / max(math.cos(component.elevation), LEAST_LEVEL),
        elevation_world=component.elevation, elevation_world_rate=up_rate, covariance_world=(hh, hv, hv, vv),
        attitude_known=motion.is_known(track.time), range=1.0 / inverse if known else math.nan,
        range_variance=variance / inverse**4 if known else math.inf)
