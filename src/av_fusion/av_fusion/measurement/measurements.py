"""What the trackers are told and what they tell, as plain data: tuples with names, which are made thousands of times a second.

Azimuths are in rad, counter-clockwise; "body" is the rig's levelled frame (x forward), "world" is ENU. Times are capture
times in seconds.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Hypothesis(NamedTuple):
    """One direction (body frame, rad, rad^2) that a sound may have come from."""

    azimuth: float
    azimuth_variance: float
    elevation: float = 0.0
    elevation_variance: float = math.inf


class DoaMeasurement(NamedTuple):
    """One sound heard: its hypotheses are mirror images, of which exactly one is true.

    `window` in s is the length of sound that the estimate rests on: estimates that overlap are not independent.
    """

    time: float
    hypotheses: tuple[Hypothesis, ...]
    confidence: float
    window: float = 0.5


class Detection(NamedTuple):
    """One thing seen (body frame, rad, rad^2), with the detector's calibrated confidence 0..1."""

    azimuth: float
    azimuth_variance: float
    confidence: float
    elevation: float = 0.0
    elevation_variance: float = math.inf


class CameraMeasurement(NamedTuple):
    """One picture looked at, with all that was detected in it, be it nothing.

    The view is centred at `view_azimuth` (body, rad) and reaches `half_view` (rad) to both sides. `visibility` (0..1) is
    how well a target would be seen, nan when unknown.
    """

    time: float
    detections: tuple[Detection, ...]
    view_azimuth: float = 0.0
    half_view: float = 0.6
    visibility: float = math.nan

    @property
    def best(self) -> Detection | None:
        """The detection of highest confidence."""
        return max(self.detections, key=lambda detection: detection.confidence, default=None)


SHARPEST, BLUNTEST = 1e-10, 40.0  # rad^2: variances beyond are an error of whoever sent them, or say nothing


def usable_doa(sound: DoaMeasurement) -> DoaMeasurement | None:
    """The sound with those hypotheses that can be meant; None when nothing is left of it."""
    if not (math.isfinite(sound.time) and 0.0 < sound.confidence <= 1.0 and 0.0 < sound.window <= 60.0):
        return None
    kept = _sensible(sound.hypotheses)
    if not kept:
        return None
    return sound if kept == sound.hypotheses else sound._replace(hypotheses=kept)


def usable_camera(look: CameraMeasurement) -> CameraMeasurement | None:
    """The picture with those detections that can be meant; None when it cannot be used at all."""
    if not (math.isfinite(look.time) and abs(look.view_azimuth) <= 10.0 and 0.0 < look.half_view <= math.pi):
        return None
    kept = tuple(d for d in _sensible(look.detections) if 0.0 <= d.confidence <= 1.0)
    visibility = math.nan if look.visibility < 0.0 or look.visibility > 1.0 else look.visibility
    unchanged = kept == look.detections and visibility is look.visibility
    return look if unchanged else look._replace(detections=kept, visibility=visibility)


def _sensible(directions: tuple) -> tuple:
    """Those with an azimuth; an elevation that cannot be counts as unknown."""
    return tuple([d if abs(d.elevation) <= 0.5 * math.pi and d.elevation_variance >= SHARPEST
                 else d._replace(elevation=0.0, elevation_variance=math.inf)
                 for d in directions if abs(d.azimuth) <= 10.0 and SHARPEST <= d.azimuth_variance <= BLUNTEST])
