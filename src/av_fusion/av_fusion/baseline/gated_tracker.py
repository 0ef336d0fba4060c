"""The published controller, kept as the reference: sight while its confidence reaches tau, else sound.

Front and back are told apart by the field of view (what is detected is in front of the camera) and, when sight fails, by a
fixed rotation: the candidate that stays put in the world is the true one. There is no filter; what is measured is reported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from av_common.angles import wrap
from av_common.track import Source, State, Track
from av_fusion.disambiguation.rotation import Image, RotationPlanner, RotationSettings
from av_fusion.filter.state_machine import MachineSettings, StateMachine
from av_fusion.measurement.measurements import (
    CameraMeasurement,
    Detection,
    DoaMeasurement,
    Hypothesis,
    usable_camera,
    usable_doa,
)
from av_fusion.measurement.rig_motion import RigMotion


@dataclass(frozen=True)
class GatedSettings:
    """`memory` s after the last sure bearing, the candidate nearest to it is still taken for the true one.

    A rotation counts once the rig turned by `least_turn` rad since the candidates were noted: the whole fixed turn, but for
    what the rig leaves of it.
    """

    memory: float = 3.0
    least_turn: float = math.radians(40.0)
    sound_delay: float = 0.0
    sight_delay: float = 0.0
    machine: MachineSettings = field(default_factory=MachineSettings)
    rotation: RotationSettings = field(default_factory=lambda: RotationSettings(fixed=math.radians(45.0)))


class GatedTracker:
    """The same interface as `BayesTracker`."""

    def __init__(self, settings: GatedSettings | None = None) -> None:
        self.settings = settings or GatedSettings()
        self.motion = RigMotion()
        self.machine = StateMachine(self.settings.machine)
        self.planner = RotationPlanner(self.settings.rotation)
        self.reset()

    def reset(self) -> None:
        """Forget the target, not the rig."""
        self._seen: tuple[float, Detection] | None = None
        self._heard: tuple[float, Hypothesis] | None = None
        self._sure: tuple[float, float] | None = None   # time and world azimuth of the last bearing known to be no mirror
        self._noted: tuple[float, float, list[float]] | None = None  # time, yaw and world candidates before a rotation
        self._candidates: list[Image] = []
        self._axis = 0.5 * math.pi
        self._visibility = math.nan

    def add_pose(self, time: float, yaw: float, yaw_rate: float = 0.0) -> None:
        """The rig's yaw in the world (rad) and its rate (rad/s) at `time`."""
        self.motion.add(time, yaw, yaw_rate)

    def add_camera(self, look: CameraMeasurement) -> None:
        """Take in a picture; only its best detection counts."""
        look = usable_camera(look)
        if look is None:
            return
        time, best = look.time - self.settings.sight_delay, look.best
        self._visibility = look.visibility
        self.machine.see(time, best.confidence if best else 0.0)
        if best and best.confidence >= self.settings.machine.tau:
            self._seen = (time, best)
            self._sure = (time, float(wrap(self.motion.yaw(time) + best.azimuth)))

    def add_doa(self, sound: DoaMeasurement) -> None:
        """Take in a sound and choose among its mirror images."""
        sound = usable_doa(sound)
        if sound is None:
            return
        time, heard = sound.time - self.settings.sound_delay, sound.hypotheses
        yaw = self.motion.yaw(time)
        self._candidates = [Image(h.azimuth, h.azimuth_variance, 0.0, 0.0, 1.0 / len(heard)) for h in heard]
        self._axis = heard[0].azimuth + 0.5 * float(wrap(heard[-1].azimuth - heard[0].azimuth))
        world = [float(wrap(yaw + h.azimuth)) for h in heard]
        if len(heard) == 1:
            self._sure = (time, world[0])
        elif self._sure is None or time - self._sure[0] > self.settings.memory:
            self._sure = self._compare_after_turn(time, yaw, world)
        chosen = 0
        if self._sure is not None:
            chosen = min(range(len(world)), key=lambda k: abs(wrap(world[k] - self._sure[1])))
            self._sure = (time, world[chosen])
        self._heard = (time, heard[chosen])
        self.machine.hear(time, sound.confidence)

    @property
    def heard(self) -> float | None:
        """World azimuth (rad) of the image taken of the newest sound."""
        return None if self._heard is None else float(wrap(self.motion.yaw(self._heard[0]) + self._heard[1].azimuth))

    def estimate(self, time: float) -> Track:
        """The newest bearing of the sense that leads, carried to `time` by the rig's turn alone."""
        newest = max([entry[0] for entry in (self._seen, self._heard) if entry], default=-math.inf)
        state = self.machine.step(time, time - newest < self.settings.memory)
        machine = self.machine
        common = {'time': time, 'state': state, 'reason': machine.reason, 'changed': machine.changed,
                  'sound_confidence': machine.sound_confidence, 'sight_confidence': machine.sight_confidence,
                  'visibility': self._visibility}
        by_sight = state == State.VISUAL_ACTIVE or self._heard is None
        entry = self._seen if by_sight else self._heard
        if state == State.NONE or entry is None:
            return Track(**common)
        measured, direction = entry
        yaw = self.motion.yaw(time)
        azimuth_world = float(wrap(self.motion.yaw(measured) + direction.azimuth))
        azimuth = float(wrap(azimuth_world - yaw))
        resolved = self._sure is not None and time - self._sure[0] <= self.settings.memory
        sure = 0.95 if resolved else 0.5
        if resolved:
            self.planner.cancel()
        rotation = 0.0 if resolved else self.planner.plan(
            time, yaw, lambda: self._candidates, self._axis, self._visibility)
        return Track(
            **common, source=Source.SIGHT if by_sight else Source.SOUND, azimuth=azimuth,
            azimuth_variance=direction.azimuth_variance, elevation=direction.elevation,
            elevation_variance=direction.elevation_variance, azimuth_world=azimuth_world, measured=measured,
            front_probability=sure if math.cos(azimuth) > 0.0 else 1.0 - sure, resolved=resolved,
            requested_rotation=rotation, sound_weight=float(not by_sight), sight_weight=float(by_sight))

    def diagnostics(self) -> dict[str, str]:
        """See `Tracker`."""
        return self.machine.diagnostics()

    def _compare_after_turn(self, time: float, yaw: float, world: list[float]) -> tuple[float, float] | None:
        """The candidate that stayed put while the rig turned, once it has turned far enough."""
        if self._noted is None or time < self._noted[0]:
            self._noted = (time, yaw, world)
            return None
        if abs(wrap(yaw - self._noted[1])) < self.settings.least_turn:
            return None
        moved = [min(abs(float(wrap(w - before))) for before in self._noted[2]) for w in world]
        self._noted = None
        return time, world[min(range(len(world)), key=lambda k: moved[k])]
