"""Measurements in the gates of tracks: what of an input with two sources continues what was known before."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence

from av_common.angles import wrap
from av_fusion.filter.gaussian_mixture import BirthComponent
from av_fusion.filter.hearing import birth_of, hear
from av_fusion.filter.past_state import PastState
from av_fusion.filter.settings import BayesSettings
from av_fusion.filter.target_density import Image, TargetDensity, share_in_view
from av_fusion.measurement.measurements import (
    CameraMeasurement,
    Detection,
    DoaMeasurement,
    Hypothesis,
    usable_camera,
    usable_doa,
)
from av_fusion.measurement.rig_motion import RigMotion

LEAST_EXISTENCE, LEAST_WEIGHT = 0.5, 0.3  # of a track, and of a component within it, that have a gate
LARGEST_VARIANCE = math.radians(20.0) ** 2  # rad^2, of such a component: what is anywhere in a wide gate proves nothing
LEAST_IN_VIEW = 0.9  # probability that the camera shows such a component, of which a detection can be

COMPARED_S = 0.3  # for which measurements in one gate must agree
FASTEST = 0.3  # rad/s, of a direction meanwhile


class Agreement:
    """Compares the measurements of an input in the gates of tracks: of two that contradict each other one is false."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, list[tuple[float, float]]]] = deque()

    def add(self, time: float, directions: Iterable[Hypothesis | Detection]) -> bool:
        """Note directions; returns whether they agree with all recent ones.

        Parameters:
            time (s): their capture time.
            directions: in the body frame; at least one of them must be within three standard deviations.
        """
        new = [(direction.azimuth, direction.across_variance) for direction in directions]
        self._recent = deque(row for row in self._recent if abs(row[0] - time) <= COMPARED_S)
        agrees = all(any(abs(wrap(a - b)) <= 3.0 * math.sqrt(u + v) + FASTEST * abs(time - then)
                         for a, u in new for b, v in old) for then, old in self._recent)
        self._recent.append((time, new))
        return agrees


def gated_doas(measurements: Sequence[DoaMeasurement], densities: Sequence[TargetDensity], settings: BayesSettings,
               motion: RigMotion) -> list[DoaMeasurement]:
    """The directions of arrival within three standard deviations of a track.

    Parameters:
        measurements: those of one window.
        densities: the tracks, which are predicted to its time.
        settings, motion: of the tracks.
    """
    kept = []
    for usable in filter(None, map(usable_doa, measurements)):
        time = usable.time - settings.sound_delay
        if _is_expected(hear(time, usable, 1.0, settings, motion).births, _gates(time, densities)):
            kept.append(usable)
    return kept


def gated_image(measurement: CameraMeasurement, densities: Sequence[TargetDensity], settings: BayesSettings,
                motion: RigMotion) -> CameraMeasurement | None:
    """The image with the detections within three standard deviations of a track; None without any.

    An image without detections tells nothing here: another source may send one for each.

    Parameters:
        measurement: the image.
        densities, settings, motion: see `gated_doas`.
    """
    usable = usable_camera(measurement)
    if usable is None:
        return None
    time = usable.time - settings.sight_delay
    image = Image.of(time, usable, motion.attitude(time), settings.assumed_visibility, 1.0)
    gates = [past for past in _gates(time, densities) if share_in_view(past, image.view, usable) >= LEAST_IN_VIEW]
    kept = tuple(detection for detection, direction in zip(usable.detections, image.directions, strict=True)
                 if _is_expected([birth_of(direction, 1.0, settings)], gates))
    return usable._replace(detections=kept) if kept else None


def _gates(time: float, densities: Sequence[TargetDensity]) -> list[PastState]:
    """The components of tracks, at `time` (s), that can explain a measurement."""
    found = []
    for density in densities:
        if 1.0 - density.mixture.background >= LEAST_EXISTENCE:
            lag, moved = density.advance(time)
            found += [component.at(lag, moved) for component in density.mixture.components
                      if component.weight >= LEAST_WEIGHT and component.across_variance <= LARGEST_VARIANCE]
    return found


def _is_expected(births: Sequence[BirthComponent], gates: Sequence[PastState]) -> bool:
    """Whether a measurement, given by the components that it would start, is in one of the gates."""
    return any(birth.gates(past) for past in gates for birth in births)
