"""The gimbal's orientation from what it reports, or else from a model of its commands."""

from __future__ import annotations

import math

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from transforms3d.quaternions import mat2quat

from av_common.frames import BASE_FRAME, attitude_of, checked_orientation
from av_common.freshness import is_of_clock
from av_common.gimbal_geometry import (
    BASE_STABILIZED,
    LEVEL,
    angles_of_command,
    gimbal_to_body,
    gimbal_to_mount,
    pan_and_tilt,
)
from av_common.gimbal_history import OLDEST_S, RESTART_S, GimbalHistory, sample_of
from av_common.rig import GimbalMount, Rig
from av_common.rig_messages import gimbal_message, gimbal_transform
from av_common.stamps import to_seconds
from av_interfaces.msg import GimbalState, PointingCommand

ODOMETRY_TIMEOUT_S = 0.3  # after the newest odometry, from which a stabilized gimbal's rig counts as level
LEVEL_SIGMA = math.radians(5.0)  # of a stabilized gimbal on a rig of unknown attitude
LEAST_PERIOD_S = 0.01  # between two modelled orientations
SIGMA = math.radians(1.5)  # of a gimbal at rest where it was commanded to
UNKNOWN_SIGMA = math.radians(10.0)  # of one that no command has reached yet
LAGGING = 0.3  # share of the way that is left to go which the model may be wrong by


class GimbalModel:
    """Follows commands with the lag, at most at the rate and within the limits of a gimbal. Times are in s.

    Parameters:
        gimbal: its description.
    """

    def __init__(self, gimbal: GimbalMount) -> None:
        self._lag, self._rate = gimbal.lag, math.radians(gimbal.max_rate_deg)
        self._limits = [tuple(map(math.radians, limits)) for limits in (gimbal.pan_limits_deg, gimbal.tilt_limits_deg)]
        self._angles, self._targets = [0.0, 0.0], [0.0, 0.0]
        self._sigma, self._time = UNKNOWN_SIGMA, -math.inf

    def command(self, time: float, pan: float, tilt: float) -> None:
        """Note a command. The first one tells where the gimbal is: commands follow each other without jumps.

        Parameters:
            time (s): when the gimbal receives it.
            pan, tilt (rad): the angles about the mount's axes.
        """
        self._advance(time)
        self._targets = [min(max(target, low), high)
                         for target, (low, high) in zip((pan, tilt), self._limits, strict=True)]
        if self._sigma == UNKNOWN_SIGMA:
            self._angles, self._sigma = list(self._targets), SIGMA

    def correct(self, time: float, pan: float, tilt: float) -> None:
        """Continue from measured angles.

        Parameters:
            time (s): when they were measured.
            pan, tilt (rad): about the mount's axes.
        """
        if self._sigma == UNKNOWN_SIGMA:
            self._targets = [pan, tilt]
        self._angles, self._sigma, self._time = [pan, tilt], SIGMA, time

    def at(self, time: float) -> tuple[float, float, float]:
        """Pan and tilt (rad) at a time (s), which should not decrease, and the variance (rad^2) of each."""
        self._advance(time)
        left = math.hypot(*(target - angle for target, angle in zip(self._targets, self._angles, strict=True)))
        pan, tilt = self._angles
        return pan, tilt, self._sigma**2 + (LAGGING * left) ** 2

    def _advance(self, time: float) -> None:
        if time < self._time - RESTART_S:  # the clock was set back
            self._time = time
        dt = max(time - self._time, 0.0) if math.isfinite(self._time) else 0.0
        self._time = max(self._time, time)
        share = 1.0 - math.exp(-dt / self._lag) if self._lag > 0.0 else 1.0
        most = self._rate * dt
        self._angles = [angle + min(max(share * (target - angle), -most), most)
                        for angle, target in zip(self._angles, self._targets, strict=True)]


class GimbalStage:
    """Makes `gimbal/state` where the gimbal does not, and transforms of all that is used. Times are in s of the node's clock.

    Each `GimbalState` comes back by `on_state`, whoever published it. The model fills the gaps between measured ones, and
    takes over where they end, from the last measured angles on.

    Attributes:
        history: the orientations that are used.

    Parameters:
        rig: description of a rig with a gimbal.
        joints: names of its joints of pan, tilt, and roll between them, in `joint_states`; empty where there is none. Positions
            turn left, up and right side down; a minus before the name reverses that.
        joint_sigma (rad): standard deviation of the joints' positions.
        use_model: whether there is a model.
    """

    def __init__(self, rig: Rig, joints: tuple[str, str, str] = ('', '', ''), joint_sigma: float = 0.0,
                 use_model: bool = True) -> None:
        if rig.gimbal is None:
            raise ValueError('the rig has no gimbal')
        self.history = GimbalHistory()
        self._gimbal, self._joints, self._joint_variance = rig.gimbal, joints, joint_sigma**2
        self._model, self._use_model = GimbalModel(rig.gimbal), use_model
        self._attitude, self._posed = LEVEL, -math.inf  # of the newest odometry, and its stamp
        self._modelled = -math.inf
        self._measured_once = False

    def on_state(self, message: GimbalState, arrival: float) -> TransformStamped | None:
        """The transform of an orientation, None for a modelled one while measured ones arrive. Raises ValueError.

        Parameters:
            message: the orientation.
            arrival (s): time of its arrival.
        """
        sample = sample_of(message, self._gimbal.frame)
        if not self.history.add(sample, arrival):
            return None
        if sample.measured:
            self._measured_once = True
            attitude = self._attitude_at(sample.time) or LEVEL
            self._model.correct(sample.time, *pan_and_tilt(self._gimbal, sample.rotation, attitude))
        return gimbal_transform(self._gimbal, message)

    def on_joints(self, message: JointState, arrival: float) -> GimbalState | None:
        """The orientation that the joints' positions give; None for the joints of something else. Raises ValueError.

        Parameters:
            message: positions of joints.
            arrival (s): time of its arrival.
        """
        if not any(self._joints[:2]):
            return None
        if len(message.position) not in (0, len(message.name)):
            raise ValueError(f'{len(message.position)} positions of {len(message.name)} joints')
        positions = dict(zip(message.name, message.position, strict=False))
        named = [(name.removeprefix('-'), -1.0 if name.startswith('-') else 1.0) for name in self._joints]
        if not all(name in positions for name, _ in named if name):
            return None
        pan, tilt, roll = (sign * positions[name] if name else 0.0 for name, sign in named)
        if not all(math.isfinite(angle) for angle in (pan, tilt, roll)):
            raise ValueError(f'positions {pan}, {tilt}, {roll} of the joints, expected finite angles')
        turned = self._gimbal.mount.rotation @ gimbal_to_mount(pan, tilt, roll)
        time = to_seconds(message.header.stamp)
        return gimbal_message(self._gimbal.frame, time, mat2quat(turned), self._joint_variance, measured=True)

    def on_command(self, message: PointingCommand, arrival: float) -> None:
        """Note what the gimbal is commanded to. Raises ValueError for an impossible command.

        Parameters:
            message: the command.
            arrival (s): time of its arrival.
        """
        if not message.move_gimbal:
            return
        if not (math.isfinite(message.pan) and math.isfinite(message.tilt)):
            raise ValueError(f'pan {message.pan} and tilt {message.tilt} rad, expected finite angles')
        if not is_of_clock(to_seconds(message.header.stamp), arrival, OLDEST_S):
            raise ValueError('a command that is not of this time')
        stabilized = message.header.frame_id == BASE_STABILIZED
        if not (stabilized or message.header.frame_id == BASE_FRAME):
            raise ValueError(f'a command in {message.header.frame_id!r}, expected {BASE_FRAME!r} or '
                             f'{BASE_STABILIZED!r}')
        attitude = self._attitude_at(arrival) or LEVEL
        self._model.command(arrival, *angles_of_command(self._gimbal, message.pan, message.tilt, stabilized, attitude))

    def on_odometry(self, message: Odometry, arrival: float) -> GimbalState | None:
        """The modelled orientation at the instant of a pose of the rig, None where it is measured. Raises ValueError.

        Parameters:
            message: pose of the rig in ENU.
            arrival (s): time of its arrival.
        """
        stamp, q = to_seconds(message.header.stamp), checked_orientation(attitude_of(message.pose.pose.orientation), 'attitude')
        if not is_of_clock(stamp, arrival, OLDEST_S):
            raise ValueError(f'stamp {stamp - arrival:+.2f} s from its arrival')
        if self._posed - OLDEST_S < stamp <= self._posed:
            return None
        self._attitude, self._posed = q, stamp
        return self._modelled_at(stamp)

    def on_time(self, now: float) -> GimbalState | None:
        """The modelled orientation where neither the gimbal reports one nor odometry comes; to be called often."""
        return None if self._attitude_at(now) is not None and now - self._modelled < ODOMETRY_TIMEOUT_S \
            else self._modelled_at(now)

    def problem(self, now: float) -> str:
        """Why the orientation is that of the model although it was measured before; empty if it was not, or still is."""
        lost = self._measured_once and not self.history.has_feedback(now)
        instead = 'that of the model is used' if self._use_model else 'what the camera sees is not used'
        return f'the gimbal reports no orientation any more: {instead}' if lost else ''

    def source(self, now: float) -> str:
        """Where the orientation comes from, for diagnostics."""
        return 'feedback' if self.history.has_feedback(now) else 'model of the commands'

    def _modelled_at(self, time: float) -> GimbalState | None:
        if time < self._modelled - OLDEST_S:  # the clock was set back
            self._modelled = -math.inf
        if not (self._use_model and self.history.has_gap(time)) or time < self._modelled + LEAST_PERIOD_S:
            return None
        self._modelled = time
        attitude, (pan, tilt, variance) = self._attitude_at(time), self._model.at(time)
        unknown = self._gimbal.stabilized and attitude is None
        turned = gimbal_to_body(self._gimbal, pan, tilt, attitude or LEVEL)
        variance += unknown * LEVEL_SIGMA**2
        return gimbal_message(self._gimbal.frame, time, mat2quat(turned), variance, measured=False)

    def _attitude_at(self, time: float) -> tuple[float, float, float, float] | None:
        """Attitude of the rig, None if it is not known at a time (s)."""
        return self._attitude if abs(time - self._posed) <= ODOMETRY_TIMEOUT_S else None
