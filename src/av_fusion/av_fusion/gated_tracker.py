"""The published controller, kept as the reference: the camera leads while its score reaches tau, else the microphones.

Front and back are resolved by the field of view (detected objects are in front of the camera) and, without detections, by a
fixed rotation: the candidate that keeps its direction in the world is the true one. There is no filter; measurements are
reported as they are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

from av_common.angles import wrap
from av_common.track import Source, State, Track
from av_fusion.disambiguation.rotation import DONE, NO_CAMERA, Candidate, RotationPlanner
from av_fusion.measurement.measurements import CameraMeasurement, DoaMeasurement
from av_fusion.measurement.rig_motion import Pose
from av_fusion.measurement.vectors import ZERO
from av_fusion.plain_tracker import FORGET_S, PlainTracker
from av_fusion.state_machine import StateMachine

ROTATION = math.radians(45.0)  # that is requested
LEAST_TURN = ROTATION - 2.0 * DONE  # after which candidates are compared: the rig does not complete the rotation
RESOLVED_PROBABILITY = 0.95  # reported for a resolved hemisphere


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
        self._bearings: dict[Source, tuple[float, float]] = {}  # newest azimuth in the world and its variance, by sensor
        self._known: tuple[float, float] | None = None  # time and azimuth in the world of the last unambiguous bearing
        self._before: tuple[float, float, list[float]] | None = None  # time, yaw, and candidates, before a rotation
        self._images = 0  # of what was heard last, by mirrors
        self._visibility = math.nan

    def reset(self, learned: bool = False) -> None:
        """See `PlainTracker`."""
        super().reset(learned)
        self.machine.restart()
        self.planner.cancel()

    def add_pose(self, pose: Pose) -> None:
        """See `PlainTracker`."""
        jump = self.motion.add(pose, max(self._newest.values()))
        if jump is not None:  # earlier directions in the world are not valid; those in the body were measured
            turn = math.atan2(jump[1][0], jump[0][0])
            self._bearings = {source: (float(wrap(azimuth + turn)), variance)
                              for source, (azimuth, variance) in self._bearings.items()}
            self._known = self._before = None
            self.planner.cancel()

    def add_camera(self, measurement: CameraMeasurement) -> None:
        """See `PlainTracker`; only the detection of highest score is used."""
        time, best = measurement.time - self._sight_delay, measurement.best
        if time >= self._newest[Source.SIGHT]:  # else a newer one is known
            self._visibility = measurement.visibility
            self.machine.on_image(time, best.score if best else 0.0, measurement.camera)
            super().add_camera(measurement)

    def add_doas(self, measurements: Sequence[DoaMeasurement]) -> None:
        """See `PlainTracker`; the publication has one source."""
        for measurement in measurements[:1]:
            time, images = measurement.time - self._sound_delay, measurement.hypotheses
            if time < self._newest[Source.SOUND]:
                return
            yaw, self._images = self.motion.yaw(time), len(images)
            world = [image.azimuth + yaw for image in images]
            if len(images) == 1:
                self._known = time, world[0]
            elif not self._is_resolved(time):
                self._known = self._compare_after_turn(time, yaw, world)
            self.machine.on_doa(time, measurement.confidence)
            super().add_doas([measurement])

    def update(self, time: float, azimuth: float, variance: float, source: Source) -> None:
        """See `PlainTracker`: detected objects are in front of the camera, so that one that is seen is unambiguous."""
        self._bearings[source] = azimuth, variance
        if source == Source.SIGHT or self._known is not None:
            self._known = time, azimuth

    def predict(self, time: float) -> tuple[float, float] | None:
        """See `PlainTracker`: where the target was last, without a variance."""
        return None if self._known is None else (self._known[1], 0.0)

    def tune(self, tau: float, confirm_threshold: float) -> None:
        """See `PlainTracker`."""
        if tau < self.machine.tau:
            self.machine.restart()  # of the detections below the old one no direction is known
        self.machine.tau = self.tau = tau

    def estimate(self, time: float) -> Track:
        """See `PlainTracker`: the newest bearing of the leading sensor, corrected for the rig's rotation since."""
        machine, newest = self.machine, max(self._newest, key=self._newest.__getitem__)
        state = machine.step(time, time - self._newest[newest] < FORGET_S)
        track = Track(time=time, state=state, reason=machine.reason, changed=machine.changed,
                      sound_confidence=machine.sound_confidence, sight_confidence=machine.sight_confidence,
                      visibility=self._visibility)
        leading = {State.VISUAL_ACTIVE: Source.SIGHT, State.ACOUSTIC_ACTIVE: Source.SOUND}.get(state, newest)
        if state == State.NONE or leading not in self._bearings:
            return track
        azimuth_world, variance = self._bearings[leading]
        yaw = self.motion.yaw(time)
        azimuth = float(wrap(azimuth_world - yaw))
        resolved, rotation = self._resolve(time, yaw)
        probability = RESOLVED_PROBABILITY if resolved else 0.5
        source = Source.NOTHING if state == State.COASTING else leading
        return track._replace(
            source=source, azimuth=azimuth, azimuth_variance=variance, azimuth_world=azimuth_world,
            covariance_world=(variance, 0.0, 0.0, math.inf), attitude_known=self.motion.is_known(time),
            measured=self._newest[leading], front_probability=probability if math.cos(azimuth) > 0.0 else 1.0 - probability,
            resolved=resolved, requested_rotation=rotation, sound_weight=float(source == Source.SOUND),
            sight_weight=float(source == Source.SIGHT))

    def diagnostics(self) -> dict[str, str]:
        """See `PlainTracker`."""
        return self.machine.diagnostics()

    def _is_resolved(self, time: float) -> bool:
        """Whether a bearing was unambiguous less than FORGET_S before `time` (s): the nearest candidate is the true one."""
        return self._known is not None and time - self._known[0] <= FORGET_S

    def _resolve(self, time: float, yaw: float) -> tuple[bool, float]:
        """Whether the hemisphere is resolved, and the rotation (rad) requested if it is not."""
        if self._is_resolved(time):
            self.planner.cancel()
            return True, 0.0
        either = [Candidate(0.0, 0.0, 0.0, 0.0, 0.5)] * self._images  # the rotation is the same for all
        return False, self.planner.plan(time, yaw, lambda: [either], ZERO, NO_CAMERA, RESOLVED_PROBABILITY)

    def _compare_after_turn(self, time: float, yaw: float, world: list[float]) -> tuple[float, float] | None:
        """The candidate that kept its direction in the world while the rig rotated, once it has rotated far enough."""
        then, turned_from, azimuths = self._before or (math.inf, yaw, world)
        if time < then or time - self._newest[Source.SOUND] > FORGET_S:
            self._before = time, yaw, world
            return None
        if abs(wrap(yaw - turned_from)) < LEAST_TURN:
            return None
        self._before = None
        return time, min(world, key=lambda azimuth: min(abs(wrap(azimuth - before)) for before in azimuths))
