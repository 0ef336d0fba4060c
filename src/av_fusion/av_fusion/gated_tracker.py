"""The published controller, kept as the reference: the camera leads while its score reaches tau, else the microphones.

Front and back are resolved by the field of view (detected objects are in front of the camera) and, without detections, by a
fixed rotation: the candidate that keeps its direction in the world is the true one. There is no filter; measurements are
reported as they are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

from av_common.angles import wrap
from av_common.track import Source, State, Track
from av_fusion.disambiguation.rotation import NO_CAMERA, Candidate, RotationPlanner
from av_fusion.measurement.measurements import CameraMeasurement, Detection, DoaMeasurement, Hypothesis
from av_fusion.measurement.rig_motion import Pose
from av_fusion.measurement.vectors import ZERO, angles, direction, turned, turned_back
from av_fusion.plain_tracker import FORGET_S, PlainTracker
from av_fusion.state_machine import StateMachine

ROTATION = math.radians(45.0)  # that is requested
LEAST_TURN = math.radians(40.0)  # after which candidates are compared: the rig does not complete the rotation
RESOLVED_PROBABILITY = 0.95  # reported for a resolved hemisphere


class _Stored(NamedTuple):
    """Candidates before a rotation: time (s), the rig's yaw (rad) and azimuths in the world (rad)."""

    time: float
    yaw: float
    azimuths: list[float]


class GatedTracker(PlainTracker):
    """Implements `Tracker` without a filter.

    Attributes:
        machine: decides which sensor leads.
        planner: requests the fixed rotation.

    Parameters:
        parameters, gimbal: see `PlainTracker`.
    """

    FOLDED: ClassVar[bool] = False

    def __init__(self, parameters: Any = None, gimbal: object = None) -> None:
        super().__init__(parameters, gimbal)
        self.machine = StateMachine(self.tau)
        self.planner = RotationPlanner(fixed=ROTATION)

    def restart(self) -> None:
        """Forget the target."""
        self._used: dict[Source, Hypothesis | Detection] = {}  # the newest of each sensor
        self._unambiguous: tuple[float, float] | None = None  # time and world azimuth of the last unambiguous bearing
        self._stored: _Stored | None = None
        self._images = 0  # mirror images of what was heard last
        self._visibility = math.nan

    def reset(self) -> None:
        """See `PlainTracker`."""
        super().reset()
        self.machine.restart()
        self.planner.cancel()

    def add_pose(self, pose: Pose) -> None:
        """See `PlainTracker`."""
        if self.motion.add(pose) is not None:  # earlier directions in the world are not valid
            self._unambiguous = self._stored = None
            self.planner.cancel()

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """See `PlainTracker`; only the detection of highest score is used."""
        time, best = measurement.time - self._sight_delay, measurement.best
        if time < self._newest[Source.SIGHT]:
            return  # late: a newer one is known
        self._visibility = measurement.visibility
        self.machine.on_image(time, best.score if best else 0.0, measurement.camera)
        if best and best.score >= self.machine.tau:
            self._used[Source.SIGHT], self._newest[Source.SIGHT] = best, time
            self._unambiguous = (time, self._world_azimuth(time, best))

    def add_doas(self, measurements: Sequence[DoaMeasurement]) -> None:
        """See `PlainTracker`; one of the mirror images is chosen."""
        for measurement in measurements[:1]:  # that of the strongest source: the publication has one
            time, images = measurement.time - self._sound_delay, measurement.hypotheses
            if time < self._newest[Source.SOUND]:
                return
            self._images, world = len(images), [self._world_azimuth(time, image) for image in images]
            if len(images) == 1:
                self._unambiguous = (time, world[0])
            elif not self._is_resolved(time):
                self._unambiguous = self._compare_after_turn(time, self.motion.yaw(time), world)
            chosen = 0
            if self._unambiguous is not None:
                known = self._unambiguous[1]
                chosen = min(range(len(world)), key=lambda k: abs(wrap(world[k] - known)))
                self._unambiguous = (time, world[chosen])
            self._used[Source.SOUND], self._newest[Source.SOUND] = images[chosen], time
            self.machine.on_doa(time, measurement.confidence)

    def _world_azimuth(self, time: float, measured: Hypothesis | Detection) -> float:
        return angles(turned(self.motion.attitude(time), direction(measured.azimuth, measured.elevation)))[0]

    def tune(self, tau: float, confirm_threshold: float) -> None:
        """See `PlainTracker`."""
        if tau < self.machine.tau:
            self.machine.restart()  # of the detections below the old one no direction is known
        self.machine.tau = tau

    def estimate(self, time: float) -> Track:
        """See `PlainTracker`: the newest bearing of the leading sensor, corrected for the rig's rotation since."""
        machine, newest = self.machine, max(self._newest, key=self._newest.__getitem__)
        state = machine.step(time, time - self._newest[newest] < FORGET_S)
        track = Track(time=time, state=state, reason=machine.reason, changed=machine.changed,
                      sound_confidence=machine.sound_confidence, sight_confidence=machine.sight_confidence,
                      visibility=self._visibility)
        leading = {State.VISUAL_ACTIVE: Source.SIGHT, State.ACOUSTIC_ACTIVE: Source.SOUND}.get(state, newest)
        if state == State.NONE or leading not in self._used:
            return track
        measured, found = self._newest[leading], self._used[leading]
        world = turned(self.motion.attitude(measured), direction(found.azimuth, found.elevation))
        azimuth, elevation = angles(turned_back(self.motion.attitude(time), world))
        azimuth_world, elevation_world = angles(world)
        resolved, rotation = self._resolve(time, self.motion.yaw(time))
        probability = RESOLVED_PROBABILITY if resolved else 0.5
        source = Source.NOTHING if state == State.COASTING else leading
        return track._replace(
            source=source, azimuth=azimuth, azimuth_variance=found.across_variance, elevation=elevation,
            elevation_variance=found.elevation_variance, azimuth_world=azimuth_world, elevation_world=elevation_world,
            attitude_known=self.motion.is_known(time), measured=measured,
            covariance_world=(found.across_variance, 0.0, 0.0, found.elevation_variance),
            front_probability=probability if math.cos(azimuth) > 0.0 else 1.0 - probability, resolved=resolved,
            requested_rotation=rotation, sound_weight=float(source == Source.SOUND), sight_weight=float(source == Source.SIGHT))

    def diagnostics(self) -> dict[str, str]:
        """See `PlainTracker`."""
        return self.machine.diagnostics()

    def _is_resolved(self, time: float) -> bool:
        """Whether a bearing was unambiguous less than FORGET_S before `time` (s): the nearest candidate is the true one."""
        return self._unambiguous is not None and time - self._unambiguous[0] <= FORGET_S

    def _resolve(self, time: float, yaw: float) -> tuple[bool, float]:
        """Whether the hemisphere is resolved, and the rotation (rad) requested if it is not."""
        if self._is_resolved(time):
            self.planner.cancel()
            return True, 0.0
        either = [Candidate(0.0, 0.0, 0.0, 0.0, 0.5)] * self._images  # the rotation is the same for all
        return False, self.planner.plan(time, yaw, lambda: [either], ZERO, NO_CAMERA, RESOLVED_PROBABILITY)

    def _compare_after_turn(self, time: float, yaw: float, world: list[float]) -> tuple[float, float] | None:
        """The candidate that kept its direction in the world while the rig rotated, once it has rotated far enough."""
        stored = self._stored
        if stored is None or time < stored.time or time - self._newest[Source.SOUND] > FORGET_S:
            self._stored = _Stored(time, yaw, world)
            return None
        if abs(float(wrap(yaw - stored.yaw))) < LEAST_TURN:
            return None
        moved = [min(abs(float(wrap(azimuth - before))) for before in stored.azimuths) for azimuth in world]
        self._stored = None
        return time, world[min(range(len(world)), key=lambda k: moved[k])]
