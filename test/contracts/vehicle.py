"""A vehicle that obeys the pointing stage: fusion, commands, a body with dead time and lag, and the limits of every command."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from formula_rig import START, STEP, Moment, Source
from judged_rig import FormulaRig
from scipy.spatial.transform import Rotation

from av_common.freshness import Instant
from av_common.parameters import node_parameters
from av_common.rig import UNDESCRIBED_GIMBAL, GimbalMount
from av_interfaces.msg import PointingCommand
from av_pointing.settings import GIMBAL_ACCELERATION
from av_pointing.stage import make_pointing_stage

DEAD_S, LAG_S = 0.1, 0.3        # of the body's answer to a yaw rate


class Vehicle:
    """A formula rig on a body that turns as it is commanded.

    Attributes:
        rig: sensors and fusion.
        commands: time (s) and command of each output of the pointing stage.
        yaw: heading (rad) by steps.

    Parameters:
        sources: see `FormulaRig`.
        pointing: parameters of pointing_node that differ from the defaults.
        gimbal: carries the camera, and is where its command was a step ago; None where the camera is fixed.
        rig: the kind of rig.
        options: further fields of `FormulaRig`.
    """

    def __init__(self, sources: list[Source], pointing: dict[str, Any] | None = None, gimbal: GimbalMount | None = None,
                 rig: type[FormulaRig] = FormulaRig, **options: Any) -> None:
        self._parameters = node_parameters('av_pointing', 'pointing_node', overrides={'enabled': True, **(pointing or {})})
        self._gimbal, self.pointing = gimbal, make_pointing_stage(self._parameters, gimbal)
        self.commands: list[tuple[float, PointingCommand]] = []
        self.yaw, self._rate = [0.0], 0.0
        self._looks = [(0.0, 0.0)]
        carrier = {} if gimbal is None else {'gimbal': gimbal, 'camera': self._camera}
        self.rig = rig(sources, attitude=self.attitude, on_output=self._obey, on_pose=self._pose, **carrier, **options)

    def attitude(self, t: float) -> Rotation:
        """The body's attitude at a time (s)."""
        return Rotation.from_euler('z', np.interp(t, STEP * np.arange(len(self.yaw)), self.yaw))

    def run(self, seconds: float) -> Vehicle:
        """Go on for `seconds`; returns the vehicle."""
        for t in self.rig.steps(seconds):
            wanted = next((command.yaw_rate for when, command in reversed(self.commands) if when <= t - DEAD_S), 0.0)
            self._rate += (wanted - self._rate) * STEP / LAG_S
            self.yaw.append(self.yaw[-1] + self._rate * STEP)
            self._looks.append((self.commands[-1][1].pan, self.commands[-1][1].tilt) if self.commands else (0.0, 0.0))
            self._take(self.pointing.on_time(self._instant(t)), t)
        return self

    def _camera(self, t: float) -> Rotation:
        pan, tilt = (np.interp(t, STEP * np.arange(len(self._looks)), angles) for angles in np.transpose(self._looks))
        return Rotation.from_euler('ZY', [pan, -tilt])

    def between(self, after: float, until: float = math.inf) -> list[PointingCommand]:
        """Commands of a time (s)."""
        return [command for t, command in self.commands if after <= t < until]

    def _instant(self, t: float) -> Instant:
        return Instant(50.0 + t, START + t)

    def _obey(self, moment: Moment) -> None:
        self._take(self.pointing.on_bearing(moment.bearing, self._instant(moment.t)), moment.t)

    def _pose(self, message: Any, now: float) -> None:
        self.pointing.on_odometry(message, self._instant(now))

    def _take(self, command: PointingCommand, t: float) -> None:
        self._check(command, t)
        self.rig.stage.on_command(command, START + t)
        self.commands.append((t, command))

    def _check(self, command: PointingCommand, t: float) -> None:
        """Limits of angle, rate and acceleration, against the command before."""
        given = self._parameters
        then, before = self.commands[-1] if self.commands else (t, command)
        mount = self._gimbal or UNDESCRIBED_GIMBAL
        gimbal = (mount.max_rate_deg, math.degrees(GIMBAL_ACCELERATION))
        for name, rate, acceleration in (('pan_rate', *gimbal), ('tilt_rate', *gimbal),
                                         ('yaw_rate', given.yaw_rate_deg, given.yaw_acceleration_deg)):
            now, last = math.degrees(getattr(command, name)), math.degrees(getattr(before, name))
            assert abs(now) <= rate + 1e-4, f'{name} is {now} deg/s'
            assert abs(now - last) <= acceleration * (t - then) + 1e-3, f'{name} goes from {last} to {now} in {t - then} s'
        for name, (low, high) in (('pan', mount.pan_limits_deg), ('tilt', mount.tilt_limits_deg)):
            assert low - 1e-3 <= math.degrees(getattr(command, name)) <= high + 1e-3
        if command.mode == PointingCommand.MODE_TRACK and self.rig.moments:
            bearing = self.rig.moments[-1].bearing
            assert bearing.resolved or bearing.state == bearing.STATE_VISUAL_ACTIVE, 'an open side is followed'
