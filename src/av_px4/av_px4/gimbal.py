"""Client of PX4's gimbal manager: it claims, points and releases the gimbal and monitors the acknowledgements."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from transforms3d.axangles import axangle2mat
from transforms3d.quaternions import quat2mat

from av_common.frames import attitude_ned_to_enu, checked_orientation, yaw_of
from av_common.gimbal_geometry import command_of_angles, sense_of, stabilized_to_body
from av_common.limited_axis import AxisLimits, LimitedAxis
from av_common.rig import UNDESCRIBED_GIMBAL, GimbalMount
from av_px4.commands import COMPONENT, GIMBAL_CONFIGURE, GIMBAL_PITCH_YAW, RELEASE, Command, configure, pitch_yaw

ACCEPTED, IN_PROGRESS = 0, 5
RESULTS = ('accepted', 'temporarily rejected', 'denied', 'unsupported', 'failed', 'in progress', 'cancelled')
# nav_state in which PX4 itself moves the gimbal: return, descend, terminate, land, precision landing.
PX4_USES_GIMBAL = frozenset({5, 12, 13, 18, 20})
RETRY_S = 1.0           # between claims; without an acknowledgement, after which control counts as lost
MOST_COMMANDS_HZ = 50.0  # rate of the steps of `Px4Stage`
STOPS_S = 0.2           # time of a stop from the highest rate, which gives the acceleration
YAW_LOCK, YAW_IN_VEHICLE_FRAME, YAW_IN_EARTH_FRAME = 16, 32, 64  # MAVLink's GIMBAL_DEVICE_FLAGS
FAILED = 8 + 64 + 128 + 256  # MAVLink's GIMBAL_DEVICE_ERROR_FLAGS: encoder, software, communication, calibrating
DEFAULT_MOUNT = replace(UNDESCRIBED_GIMBAL, stabilized=True)
GIMBAL_SIGMA = math.radians(1.0)  # of the report, and of the vehicle's attitude at its time


class AfterTakeover(enum.Enum):
    """What follows when another takes the gimbal; PX4's own use of it is no such case."""

    AGAIN = 'again'               # it is claimed again
    WHEN_ASKED = 'when_asked'     # it is claimed again once `move` has been false
    NEVER = 'never'


class Claim(enum.Enum):
    """State of the claim of primary control over the gimbal."""

    NONE = 'not claimed'
    ASKED = 'claimed, not yet acknowledged'
    OWNED = 'owned'


@dataclass(frozen=True)
class GimbalInputs:
    """The pointing command and the state of the vehicle.

    Parameters:
        move: whether the gimbal follows the command
        pan (rad): commanded angle about the mount's axis
        tilt (rad): commanded angle about the mount's axis
        pan_rate (rad/s): commanded rate of the direction, positive to the left
        fresh: whether pointing command, attitude and status are all fresh, and the command's mode is one that moves the gimbal
        nav_state: mode of the vehicle, None without a fresh status
        system: MAVLink id of the vehicle
        measured (rad): pan and tilt reported by the gimbal, about the mount's axes, None without a recent report
    """

    move: bool = False
    pan: float = 0.0
    tilt: float = 0.0
    pan_rate: float = 0.0
    fresh: bool = False
    nav_state: int | None = None
    system: int = 1
    measured: tuple[float, float] | None = None


class Gimbal:
    """Client of the gimbal manager. `step` returns the commands to send and must be called at 20 Hz or more.

    Parameters:
        mount: the gimbal, with its limits
        need_ack: whether a claim must be acknowledged; False for firmware without acknowledgements (PX4 1.14's default)
        after_takeover: what follows when another takes the gimbal
    """

    def __init__(self, mount: GimbalMount = DEFAULT_MOUNT, need_ack: bool = True,
                 after_takeover: AfterTakeover = AfterTakeover.AGAIN) -> None:
        self.mount, self._need_ack, self._after_takeover = mount, need_ack, after_takeover
        self.claim = Claim.NONE
        self.takeovers = 0
        self.yielded = False          # left to whoever took it
        self._taken = False           # since the newest claim
        self.last_result = ''
        self.unacknowledged = False   # acknowledgements arrived earlier but have stopped
        rate = math.radians(mount.max_rate_deg)
        self._pan, self._tilt = (LimitedAxis(AxisLimits(rate, rate / STOPS_S, *map(math.radians, limits)))
                                 for limits in (mount.pan_limits_deg, mount.tilt_limits_deg))
        self._time: float | None = None
        self._next_claim = self._sent = -math.inf
        self._waiting_since: float | None = None   # time of the oldest command without acknowledgement
        self._answered = False

    @property
    def state(self) -> str:
        """What `px4/state` says of the gimbal."""
        return 'left to another, who took it' if self.yielded else self.claim.value

    def step(self, time: float, inputs: GimbalInputs) -> list[Command]:
        """The commands to send.

        Parameters:
            time (s): current time, monotonic
            inputs: pointing command and state of the vehicle
        """
        dt = 0.0 if self._time is None else min(max(time - self._time, 0.0), 0.1)
        self._time = time
        self._watch(time)
        if not inputs.move:
            self.yielded &= self._after_takeover is AfterTakeover.NEVER
            return self.release() if self.claim is not Claim.NONE else []
        if inputs.nav_state is None or self.yielded:
            self._rest()
            return []
        if inputs.nav_state in PX4_USES_GIMBAL:  # PX4 has taken control: claim the gimbal again after this mode
            self.claim, self._waiting_since, self._taken = Claim.NONE, None, False
            self._rest()
            return []
        if self.claim is not Claim.OWNED:
            return self._ask(time, inputs)
        return self._point(time, dt, inputs)

    def acknowledge(self, time: float, command: int, result: int) -> None:
        """Process an acknowledgement.

        Parameters:
            time (s): arrival, monotonic
            command: number of the acknowledged MAVLink command
            result: MAV_RESULT
        """
        if command not in (GIMBAL_CONFIGURE, GIMBAL_PITCH_YAW):
            return
        self._waiting_since, self._answered, self.unacknowledged = None, True, False
        self.last_result = f'{command} {RESULTS[result] if result < len(RESULTS) else result}'
        granted = result in (ACCEPTED, IN_PROGRESS)
        if command == GIMBAL_CONFIGURE and self.claim is not Claim.NONE:
            self.claim = Claim.OWNED if granted else Claim.ASKED
            if not granted:
                self._next_claim = time + RETRY_S
        elif command == GIMBAL_PITCH_YAW and self.claim is Claim.OWNED and not granted:
            self.takeovers += 1
            self._taken = True
            self._give_up(time)

    def release(self) -> list[Command]:
        """The command that releases the gimbal; no command if the gimbal was not claimed."""
        claimed, self.claim = self.claim is not Claim.NONE, Claim.NONE
        self._next_claim, self._waiting_since = -math.inf, None
        self._rest()
        return [configure(RELEASE, RELEASE)] if claimed else []

    def _watch(self, time: float) -> None:
        if self._need_ack and self._waiting_since is not None and time - self._waiting_since > RETRY_S:
            self.unacknowledged = self._answered
            if self.claim is Claim.OWNED:
                self._give_up(time)

    def _give_up(self, time: float) -> None:
        self.claim, self._next_claim = Claim.ASKED, time + RETRY_S
        self._waiting_since = None
        self._rest()

    def _rest(self) -> None:
        self._pan.velocity = self._tilt.velocity = 0.0

    def _ask(self, time: float, inputs: GimbalInputs) -> list[Command]:
        if time < self._next_claim:
            return []
        if self._taken and self._after_takeover is not AfterTakeover.AGAIN:
            self.claim, self.yielded, self._taken = Claim.NONE, True, False
            return []
        self._next_claim, self._taken = time + RETRY_S, False
        self._waiting_since = time if self._waiting_since is None else self._waiting_since
        self.claim = Claim.ASKED if self._need_ack else Claim.OWNED
        if inputs.measured is not None:  # start from the gimbal's measured angles, not from the last command
            for axis, angle in zip((self._pan, self._tilt), inputs.measured, strict=True):
                axis.position = min(max(angle, axis.limits.lower), axis.limits.upper)
        return [configure(inputs.system, COMPONENT)]

    def _point(self, time: float, dt: float, inputs: GimbalInputs) -> list[Command]:
        if inputs.fresh and all(map(math.isfinite, (inputs.pan, inputs.tilt, inputs.pan_rate))):
            rate = sense_of(self.mount) * inputs.pan_rate
            # the command holds for the present time, and `follow` adds rate * dt
            self._pan.follow(inputs.pan - self._pan.position - rate * dt, rate, dt)
            self._tilt.follow(inputs.tilt - self._tilt.position, 0.0, dt)
        else:
            moving = self._pan.velocity != 0.0 or self._tilt.velocity != 0.0
            self._pan.stop(dt)
            self._tilt.stop(dt)
            if not moving:  # the gimbal holds its angles without further commands
                return []
        if time - self._sent < 0.5 / MOST_COMMANDS_HZ:
            return []
        self._sent = time
        self._waiting_since = time if self._waiting_since is None else self._waiting_since
        pan, tilt = command_of_angles(self.mount, self._pan.position, self._tilt.position)
        return [pitch_yaw(pan, tilt, self.mount.stabilized)]


def reported_rotation(message: Any, attitude_wxyz: Sequence[float]) -> NDArray[np.float64]:
    """Rotation matrix (3, 3) from the gimbal's frame (FLU) to the vehicle's body, of a GimbalDeviceAttitudeStatus.

    MAVLink gives roll and pitch from the horizon, and yaw from north or from the vehicle's heading. The gimbal is thus turned
    against the body by the vehicle's attitude.

    Parameters:
        message: of PX4 1.17
        attitude_wxyz: the vehicle's attitude (w, x, y, z) from FLU to ENU

    Raises ValueError for an impossible attitude or flags, and for a gimbal that reports a failure.
    """
    checked_orientation(message.q, 'attitude')
    if message.failure_flags & FAILED:
        raise ValueError(f'the gimbal reports the failure {message.failure_flags}')
    return stabilized_to_body(attitude_wxyz) @ _levelled(message, yaw_of(attitude_wxyz))


def _levelled(message: Any, yaw: float) -> NDArray[np.float64]:
    """Rotation matrix (3, 3) from the gimbal's frame (FLU) to the level one with the body's heading `yaw` (rad, ENU)."""
    vehicle, earth = message.device_flags & YAW_IN_VEHICLE_FRAME, message.device_flags & YAW_IN_EARTH_FRAME
    if vehicle and earth:
        raise ValueError('the gimbal reports yaw in the frames of vehicle and earth at once')
    if earth or (not vehicle and message.device_flags & YAW_LOCK):
        return np.asarray(axangle2mat((0.0, 0.0, 1.0), -yaw) @ quat2mat(attitude_ned_to_enu(message.q)))
    w, x, y, z = map(float, message.q)
    return quat2mat((w, x, -y, -z))  # FRD to FLU on either side
