"""Sources at fixed places that are no drones, such as fans and generators: learnt, and no longer taken for the target."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from av_fusion.filter.fixed_emitter import LARGEST_MOVE, Emitter
from av_fusion.filter.gaussian_component import GaussianComponent
from av_fusion.filter.gaussian_mixture import BirthComponent
from av_fusion.filter.hearing import Hearing, hear
from av_fusion.filter.settings import BayesSettings
from av_fusion.filter.target_density import TargetDensity
from av_fusion.filter.world_direction import Deviation, WorldDirection, distance
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement, usable_camera, usable_doa
from av_fusion.measurement.rig_motion import RigMotion
from av_fusion.measurement.vectors import ZERO, Rows, angles, combined, dot

# Emitters stand on the ground or on buildings, a few degrees from the horizon.
MODEL = BayesSettings(usual_elevation=0.0, usual_elevation_sigma=math.radians(5.0), sound_floor_sigma=math.radians(1.0))
GATE = 9.0  # square of a distance in standard deviations, within which a direction may stem from an emitter
DRIFT = math.radians(0.1) ** 2  # rad^2/s, of the rig's heading
# Usual range of an emitter, by which its direction is less certain when the rig moves, and displacement of the rig since it was
# heard from which the direction is not known any more.
USUAL_RANGE_M, FAR_M = 10.0, 5.0
MOST_EMITTERS = 16
# Share of the recent time for which an emitter is heard, from which it is learnt, and below which it is forgotten.
LEARNT, FORGOTTEN = 0.5, 0.05
# A sound that is not followed is not more likely a drone's than this; one that is taken for a drone's for some seconds is one.
NO_DRONE, DRONE = 0.25, 0.4
UNKNOWN = 0.5  # probability of a drone while a sound is not judged
JUDGED_S = 5.0  # over which probabilities of a drone are averaged
EMITTER_ODDS = 10.0  # by which the odds of the target are smaller in the direction of a known emitter
SIGHTING_SCORE, SIGHTING_S, NEAR_SIGHTING = 0.3, 1.0, math.radians(5.0)
MAX_GAP_S, LARGEST_STEP_S = 5.0, 1.0


@dataclass(frozen=True)
class FixedEmitterSettings:
    """Settings of `FixedEmitters`.

    Parameters:
        enabled: whether emitters are learnt.
        learn_after (s): duration for which a source is heard from one place, until it is known.
        sound_delay, sight_delay (s): delay of the stamps of directions of arrival and of images.
    """

    enabled: bool = True
    learn_after: float = 120.0
    sound_delay: float = 0.0
    sight_delay: float = 0.0


class _Sighting(NamedTuple):
    """A drone that was seen.

    Parameters:
        time (s): capture time of the image.
        azimuth (rad): in the world.
    """

    time: float
    azimuth: float


class _Sound(NamedTuple):
    """What is heard from one direction.

    Parameters:
        measurement: in the body frame.
        hearing: the same in the world.
        seen: whether a drone has just been seen there.
        drone: probability that it is a drone.
    """

    measurement: DoaMeasurement
    hearing: Hearing
    seen: bool
    drone: float


class FixedEmitters:
    """Learns the directions of steady sources in the world, and lowers the probability of a drone of what is heard from there.

    Only what was not followed can be learnt: for the whole time that learning takes, its sound must be no drone's, and no drone
    is seen there. A source whose sound is not judged is never learnt. What is learnt does not silence a direction: a sound
    that is clearly a drone's is followed there at once, a sighting lifts it, and seconds of either forget the emitter.

    Parameters:
        settings: see `FixedEmitterSettings`.
        motion: attitude and path of the rig.
    """

    def __init__(self, settings: FixedEmitterSettings, motion: RigMotion) -> None:
        self._settings, self._motion = settings, motion
        self._emitters: list[Emitter] = []
        self._sightings: list[_Sighting] = []
        self._time = -math.inf
        self._place, self._step = ZERO, 0.0  # m, where the rig is from where it began, and its displacement in this window

    def forget(self) -> int:
        """Forget everything; returns how many emitters were known."""
        count = len(self.known)
        self._emitters = []
        return count

    @property
    def known(self) -> list[tuple[float, float]]:
        """Azimuth (rad, world) of each known emitter, and since when (s)."""
        return [(emitter.component.azimuth, emitter.since) for emitter in self._emitters if emitter.is_known]

    def turn_world(self, rows: Rows) -> None:
        """Turn all directions with the world, where the rig's attitude was corrected."""
        for emitter in self._emitters:
            emitter.component.turn_world(rows)
            emitter.first = emitter.component.direction

    def judge(self, measurements: Sequence[DoaMeasurement]) -> list[DoaMeasurement]:
        """Learn from the directions of arrival of one window.

        Returns them with lower probabilities of a drone where they stem from known emitters, the target's likeliest first.

        Parameters:
            measurements: directions in the body frame, of different sources.
        """
        usable = [one for one in map(usable_doa, measurements) if one is not None]
        time = usable[0].time - self._settings.sound_delay if usable else -math.inf
        if not (self._settings.enabled and usable and self._is_oriented(time)):
            return list(measurements)
        dt = self._advance(time)
        sounds = [self._sound_of(measurement, time) for measurement in usable]
        explained = [(self._explain(emitter, sounds, time, dt), emitter.is_known or emitter.is_bystander)
                     for emitter in self._emitters]
        others = {number for number, is_other in explained if is_other}
        for number, sound in enumerate(sounds):
            if sound.drone < NO_DRONE and all(number != one for one, _ in explained):
                self._begin(sound.hearing.births)
        self._reduce()
        judged = [_lowered(sound) if number in others and not sound.seen else sound.measurement
                  for number, sound in enumerate(sounds)]
        return sorted(judged, key=lambda measurement: -measurement.target_confidence)

    def see(self, measurement: CameraMeasurement) -> None:
        """Note where drones are seen: what is heard from there is one, also to an array that hears it in two directions.

        Parameters:
            measurement: detections in the body frame.
        """
        usable = usable_camera(measurement)
        if usable is None:
            return
        time = usable.time - self._settings.sight_delay
        attitude = self._motion.attitude(time)
        seen = [angles(WorldDirection.of(d, attitude).vector)[0] for d in usable.detections if d.score >= SIGHTING_SCORE]
        self._sightings = [sighting for sighting in self._sightings if abs(time - sighting.time) < SIGHTING_S]
        self._sightings += [_Sighting(time, azimuth) for azimuth in seen]

    def diagnostics(self) -> dict[str, str]:
        """Number and directions of the known emitters."""
        if not self._settings.enabled:
            return {}
        known = [f'azimuth {math.degrees(azimuth):.0f} deg since {since:.0f} s' for azimuth, since in self.known]
        return {'fixed emitters': '; '.join([str(len(known)), *known])}

    def _is_oriented(self, time: float) -> bool:
        """Whether directions in the world are known, or the rig has no odometry and counts as fixed."""
        return self._motion.is_known(time) or not math.isfinite(self._motion.newest)

    def _advance(self, time: float) -> float:
        """Move to the time (s) of a window; returns how much (s) of it is new."""
        if time < self._time - MAX_GAP_S:  # a recording that begins again is another world
            self.forget()
            self._time = time
        last, self._time = self._time, max(time, self._time)
        if not last < time < last + MAX_GAP_S:
            return 0.0
        moved = self._motion.moved(last, time)
        self._place, self._step = combined(1.0, self._place, 1.0, moved), math.sqrt(dot(moved, moved))
        return min(time - last, LARGEST_STEP_S)

    def _sound_of(self, measurement: DoaMeasurement, time: float) -> _Sound:
        """A direction of arrival with what is known of its source."""
        hearing = hear(time, measurement, 1.0, MODEL, self._motion)
        azimuths = [sighting.azimuth for sighting in self._sightings if abs(time - sighting.time) < SIGHTING_S]
        seen = any(abs(math.remainder(birth.azimuth - azimuth, math.tau)) < NEAR_SIGHTING + 3.0 * math.sqrt(birth.hh)
                   for birth in hearing.births for azimuth in azimuths)
        unknown = math.isnan(measurement.drone_probability)
        return _Sound(measurement, hearing, seen, 1.0 if seen else UNKNOWN if unknown else measurement.drone_probability)

    def _explain(self, emitter: Emitter, sounds: Sequence[_Sound], time: float, dt: float) -> int | None:
        """Update an emitter by the likeliest direction of a window; returns the number of that, None where none is near."""
        emitter.component.covariance[0, 0] += DRIFT * dt + self._step**2 / USUAL_RANGE_M**2
        memory, recent = math.exp(-dt * math.log(2.0) / self._settings.learn_after), math.exp(-dt / JUDGED_S)
        emitter.presence *= memory
        emitter.heard *= recent
        past = emitter.component.at(0.0)
        comparisons = [sound.hearing.likelihood.compare(emitter.component, past) for sound in sounds]
        number = max(range(len(sounds)), key=lambda k: _log_density(comparisons[k].deviations))
        sound, comparison = sounds[number], comparisons[number]
        if distance(comparison.deviations) > GATE:
            return None
        emitter.place = self._place
        emitter.presence += (1.0 - memory) * sound.measurement.confidence
        emitter.drone += (1.0 - recent) * (sound.drone - emitter.drone)
        emitter.heard += 1.0 - recent
        if time - emitter.component.newest_doa >= sound.measurement.window:  # the errors of windows that overlap are alike
            emitter.note(comparison.deviations[0])
            TargetDensity.update_by_sound(time, [comparison], [1.0])
        self._decide(emitter, sound, time)
        return number

    @staticmethod
    def _decide(emitter: Emitter, sound: _Sound, time: float) -> None:
        """Whether a source that is heard becomes known, or is trusted no more."""
        if emitter.is_known:
            if emitter.drone > DRONE:
                emitter.distrust()
        elif sound.seen or emitter.drone >= NO_DRONE or not emitter.is_fixed:
            emitter.distrust()
        elif emitter.presence >= LEARNT:
            emitter.since = time

    def _begin(self, births: Sequence[BirthComponent]) -> None:
        """Note where else there may be an emitter."""
        for birth in births:
            covariance = np.zeros((5, 5))
            covariance[:2, :2] = [[birth.hh, birth.hv], [birth.hv, birth.vv]]
            component = GaussianComponent(1.0, birth.azimuth, birth.elevation, covariance,
                                          elevation_measured=birth.elevation_measured)
            self._emitters.append(Emitter(component, component.direction, self._place))

    def _reduce(self) -> None:
        """Remove emitters that are gone or the same as another one, and the least present ones where there are too many."""
        kept: list[Emitter] = []
        for emitter in sorted(self._emitters, key=lambda emitter: (not emitter.is_known, -emitter.presence)):
            direction = emitter.component.direction
            if not self._is_gone(emitter) and all(dot(direction, other.component.direction) < math.cos(LARGEST_MOVE)
                                                  for other in kept):
                kept.append(emitter)
        self._emitters = kept[:MOST_EMITTERS]

    def _is_gone(self, emitter: Emitter) -> bool:
        """Whether an emitter is not heard any more, or its direction is lost as the rig moved."""
        way = combined(1.0, self._place, -1.0, emitter.place)
        return dot(way, way) > FAR_M**2 or (emitter.is_known and emitter.presence < FORGOTTEN)


def _lowered(sound: _Sound) -> DoaMeasurement:
    """The measurement with the odds of a drone that are left where an emitter is known."""
    return sound.measurement._replace(drone_probability=sound.drone / (sound.drone + EMITTER_ODDS * (1.0 - sound.drone)))


def _log_density(deviations: Sequence[Deviation]) -> float:
    """Of a direction of arrival at an emitter: a wide one is near to all, and likely at none."""
    return -0.5 * (distance(deviations) + math.log(deviations[0].total))
