"""The published controller, kept as the reference: the camera leads while its score reaches tau, else the microphones.

Front and back are resolved by the field of view (detected objects are in front of the camera) and, without detections, by a
fixed rotation: the candidate that keeps its direction in the world is the true one. There is no filter; measurements are
reported as they are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from av_common.angles import wrap
from av_common.track import Source, State, Targets, Track
from av_fusion.disambiguation.rotation import NO_CAMERA, Candidate, RotationPlanner, RotationSettings, Tilt
from av_fusion.gated.single_target import SingleTarget
from av_fusion.measurement.measurements import (
    CameraMeasurement,
    Detection,
    DoaMeasurement,
    Hypothesis,
    usable_camera,
    usable_doa,
)
from av_fusion.measurement.rig_motion import Pose, RigMotion
from av_fusion.measurement.vectors import Vector, angles, direction, turned, turned_back
from av_fusion.state_machine import MachineSettings, StateMachine
from av_fusion.tracks.likelihood import share_within
from av_fusion.tracks.track import Track as FilterTrack

RESOLVED_PROBABILITY = 0.95  # reported for a resolved hemisphere
PREDICTION_RATE = 0.3  # rad/s, standard deviation of the target's azimuth rate, by which the variance of a prediction grows


@dataclass(frozen=True)
class GatedSettings:
    """Settings of `GatedTracker`.

    Parameters:
        memory (s): time after the last unambiguous bearing during which the candidate nearest to it counts as the true one.
        least_turn (rad): rotation since the candidates were stored after which they are compared; somewhat less than the
            fixed rotation, since the rig does not complete it.
        sound_delay, sight_delay (s): delay of the stamps of directions of arrival and of images.
        machine, rotation: settings of the parts.
    """

    memory: float = 3.0
    least_turn: float = math.radians(40.0)
    sound_delay: float = 0.0
    sight_delay: float = 0.0
    machine: MachineSettings = field(default_factory=MachineSettings)
    rotation: RotationSettings = field(default_factory=lambda: RotationSettings(fixed=math.radians(45.0)))


class _Stored(NamedTuple):
    """Candidates before a rotation: time (s), the rig's yaw (rad) and azimuths in the world (rad)."""

    time: float
    yaw: float
    azimuths: list[float]


@dataclass
class _Target:
    """State of the estimate of the target; times in s."""

    detection: tuple[float, Detection] | None = None
    direction: tuple[float, Hypothesis] | None = None
    unambiguous: tuple[float, float] | None = None  # time and world azimuth of the last unambiguous bearing
    stored: _Stored | None = None
    candidates: list[Candidate] = field(default_factory=list)
    axis: float = 0.5 * math.pi
    visibility: float = math.nan


class GatedTracker:
    """Implements `Tracker` without a filter.

    Attributes:
        settings: see `GatedSettings`.
        motion: the rig's attitude over time.
        machine: decides which sensor leads.
        planner: requests the fixed rotation.

    Parameters:
        settings: see the attribute.
    """

    def __init__(self, settings: GatedSettings | None = None) -> None:
        self.settings = settings or GatedSettings()
        self.motion = RigMotion()
        self.machine = StateMachine(self.settings.machine)
        self.planner = RotationPlanner(self.settings.rotation)
        self._target = _Target()
        self._named = SingleTarget()

    def reset(self) -> None:
        """See `Tracker`."""
        self._target = _Target()
        self.machine.restart()
        self.planner.cancel()

    def add_pose(self, pose: Pose) -> None:
        """See `Tracker`."""
        if self.motion.add(pose) is not None:  # earlier directions in the world are not valid
            self._target.unambiguous = self._target.stored = None

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """See `Tracker`; only the detection of highest score is used."""
        usable = usable_camera(measurement)
        if usable is None:
            return
        time, best = usable.time - self.settings.sight_delay, usable.best
        if self._target.detection is not None and time < self._target.detection[0]:
            return  # late: a newer one is known
        self._target.visibility = usable.visibility
        self.machine.on_image(time, best.score if best else 0.0)
        if best and best.score >= self.machine.settings.tau:
            self._target.detection = (time, best)
            self._target.unambiguous = (time, self._world_azimuth(time, best))

    def add_doas(self, measurements: Sequence[DoaMeasurement]) -> None:
        """See `Tracker`."""
        for measurement in measurements:
            self.add_doa(measurement)

    def add_doa(self, measurement: DoaMeasurement) -> None:
        """Use one direction of arrival; one of the mirror images is chosen."""
        usable, target = usable_doa(measurement), self._target
        if usable is None:
            return
        time, images = usable.time - self.settings.sound_delay, usable.hypotheses
        if target.direction is not None and time < target.direction[0]:
            return
        yaw = self.motion.yaw(time)
        target.candidates = [Candidate(h.azimuth, h.across_variance, 0.0, 0.0, 1.0 / len(images)) for h in images]
        target.axis = images[0].azimuth + 0.5 * float(wrap(images[-1].azimuth - images[0].azimuth))
        world = [self._world_azimuth(time, h) for h in images]
        if len(images) == 1:
            target.unambiguous = (time, world[0])
        elif target.unambiguous is None or time - target.unambiguous[0] > self.settings.memory:
            target.unambiguous = self._compare_after_turn(time, yaw, world)
        chosen = 0
        if target.unambiguous is not None:
            known = target.unambiguous[1]
            chosen = min(range(len(world)), key=lambda k: abs(float(wrap(world[k] - known))))
            target.unambiguous = (time, world[chosen])
        target.direction = (time, images[chosen])
        self.machine.on_doa(time, usable.confidence)

    def _world_azimuth(self, time: float, measured: Hypothesis | Detection) -> float:
        return angles(turned(self.motion.attitude(time), direction(measured.azimuth, measured.elevation)))[0]

    def use_cue(self, cue: Vector, variance: float, wrong: float) -> None:
        """See `Tracker`: the published method takes no cues."""

    def tune(self, tau: float, confirm_threshold: float) -> None:
        """See `Tracker`."""
        self.machine.settings = replace(self.machine.settings, tau=tau)

    def forget_emitters(self) -> int:
        """See `Tracker`: the published method knows no emitters."""
        return 0

    def estimate(self, time: float) -> Track:
        """See `Tracker`: the newest bearing of the leading sensor, corrected for the rig's rotation since."""
        target, machine = self._target, self.machine
        newest = max([entry[0] for entry in (target.detection, target.direction) if entry], default=-math.inf)
        state = machine.step(time, time - newest < self.settings.memory)
        track = Track(time=time, state=state, reason=machine.reason, changed=machine.changed,
                      sound_confidence=machine.sound_confidence, sight_confidence=machine.sight_confidence,
                      visibility=target.visibility)
        by_sight = state == State.VISUAL_ACTIVE or target.direction is None
        entry = target.detection if by_sight else target.direction
        if state == State.NONE or entry is None:
            return track
        measured, found = entry
        world = turned(self.motion.attitude(measured), direction(found.azimuth, found.elevation))
        azimuth, elevation = angles(turned_back(self.motion.attitude(time), world))
        azimuth_world, elevation_world = angles(world)
        resolved, rotation = self._resolve(time, self.motion.yaw(time))
        coasting = state == State.COASTING
        variance = found.across_variance + ((PREDICTION_RATE * (time - measured)) ** 2 if coasting else 0.0)
        probability = RESOLVED_PROBABILITY if resolved else 0.5
        if coasting:
            front = share_within(0.5 * math.pi, azimuth, variance)
            probability = min(probability, max(front, 1.0 - front))
        return track._replace(
            source=Source.NOTHING if coasting else Source.SIGHT if by_sight else Source.SOUND, azimuth=azimuth,
            azimuth_variance=variance, elevation=elevation, elevation_variance=found.elevation_variance,
            azimuth_world=azimuth_world, elevation_world=elevation_world, attitude_known=self.motion.is_known(time),
            covariance_world=(variance, 0.0, 0.0, found.elevation_variance), measured=measured,
            front_probability=probability if math.cos(azimuth) > 0.0 else 1.0 - probability, resolved=resolved,
            requested_rotation=rotation, sound_weight=float(not (by_sight or coasting)),
            sight_weight=float(by_sight and not coasting))

    def targets(self, track: Track) -> Targets:
        """See `Tracker`."""
        return self._named.targets(track)

    def densities(self) -> list[FilterTrack]:
        """See `Tracker`: there is no filter."""
        return []

    def select(self, identifier: int) -> None:
        """See `Tracker`."""
        self._named.select(identifier)

    def diagnostics(self) -> dict[str, str]:
        """See `Tracker`."""
        return self.machine.diagnostics()

    def _resolve(self, time: float, yaw: float) -> tuple[bool, float]:
        """Whether the hemisphere is resolved, and the rotation (rad) requested if it is not."""
        target = self._target
        if target.unambiguous is not None and time - target.unambiguous[0] <= self.settings.memory:
            self.planner.cancel()
            return True, 0.0
        return False, self.planner.plan(time, yaw, lambda: [target.candidates],
                                        Tilt((math.cos(target.axis), math.sin(target.axis), 0.0)), NO_CAMERA)

    def _compare_after_turn(self, time: float, yaw: float, world: list[float]) -> tuple[float, float] | None:
        """The candidate that kept its direction in the world while the rig rotated, once it has rotated far enough."""
        stored = self._target.stored
        if stored is None or time < stored.time:
            self._target.stored = _Stored(time, yaw, world)
            return None
        if abs(float(wrap(yaw - stored.yaw))) < self.settings.least_turn:
            return None
        moved = [min(abs(float(wrap(azimuth - before))) for before in stored.azimuths) for azimuth in world]
        self._target.stored = None
        return time, world[min(range(len(world)), key=lambda k: moved[k])]
