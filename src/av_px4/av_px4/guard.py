"""The guard of the body: the only place that decides whether a setpoint may be sent, and with what yaw rate.

PX4 1.16 obeys setpoints that arrive by DDS in any mode, even Hold. A setpoint is therefore sent only while a fresh status
says that the pilot has chosen OFFBOARD or this rig's external mode. Nothing here can arm or choose a mode.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

OFFBOARD = 14                      # vehicle_status nav_state
EXTERNAL_MODES = range(23, 31)     # nav_state of external modes 1 to 8
STOP_WITHIN = 0.3                  # s from staleness to standstill
MARGIN = 0.05                      # s of that for the steps' own period
STALL = 0.8                        # s between steps after which PX4 may have left OFFBOARD unnoticed (COM_OF_LOSS_T)


@dataclass(frozen=True)
class GuardSettings:
    """Limits of the motion, and the ages by arrival from which inputs are stale. Raises ValueError.

    `max_rate / max_acceleration` is the time to stop, at most 0.25 s. A status arrives twice a second; braking begins 0.3 s
    before it is stale, so that the last setpoint sent holds the vehicle still.

    Parameters:
        max_rate (rad/s): greatest yaw rate
        max_acceleration (rad/s^2): greatest change of the yaw rate
        command_timeout (s): for the pointing command
        bearing_timeout (s): for the bearing
        attitude_timeout (s): for PX4's attitude
        position_timeout (s): for PX4's local position
        status_timeout (s): for PX4's vehicle_status
    """

    max_rate: float = math.radians(45.0)
    max_acceleration: float = math.radians(200.0)
    command_timeout: float = 0.25
    bearing_timeout: float = 0.3
    attitude_timeout: float = 0.2
    position_timeout: float = 0.5
    status_timeout: float = 1.5

    def __post_init__(self) -> None:
        if not (self.max_rate > 0.0 and self.max_rate / self.max_acceleration <= STOP_WITHIN - MARGIN + 1e-9):
            raise ValueError(
                f'max_rate {math.degrees(self.max_rate):.1f} deg/s takes {self.max_rate / self.max_acceleration:.2f} s to stop '
                f'at max_acceleration {math.degrees(self.max_acceleration):.1f} deg/s^2, allowed are {STOP_WITHIN - MARGIN} s')
        if not self.status_timeout > 2.0 * STOP_WITHIN:
            raise ValueError(f'status_timeout is {self.status_timeout} s, expected more than {2.0 * STOP_WITHIN} s')


@dataclass(frozen=True)
class VehicleStatus:
    """The fields of px4_msgs/VehicleStatus that matter here.

    Parameters:
        nav_state: mode
        armed: motors may turn
        failsafe: PX4 itself has taken over
        system_id: MAVLink id of the vehicle
    """

    nav_state: int
    armed: bool
    failsafe: bool
    system_id: int = 1


@dataclass(frozen=True)
class Inputs:
    """State of the vehicle and of the rig. Ages are by arrival, inf for an input that never arrived.

    Parameters:
        status: newest status, None before the first
        status_age (s): of vehicle_status
        attitude_age (s): of the attitude
        position_age (s): of the local position
        command_age (s): of the pointing command
        bearing_age (s): of the bearing
        yaw_rate (rad/s): of the pointing command, counter-clockwise
        move: the yaw rate is to be followed
        own_mode: nav_state of the rig's external mode while PX4 confirms it, else None
        place_known: there is a position to hold
        unacknowledged: commands are sent and no acknowledgement arrives
    """

    status: VehicleStatus | None = None
    status_age: float = math.inf
    attitude_age: float = math.inf
    position_age: float = math.inf
    command_age: float = math.inf
    bearing_age: float = math.inf
    yaw_rate: float = 0.0
    move: bool = False
    own_mode: int | None = None
    place_known: bool = False
    unacknowledged: bool = False

    def healthy(self, settings: GuardSettings) -> bool:
        """Whether the vehicle can be held in place. If not, PX4 takes over (COM_OF_LOSS_T, or the mode's arming check)."""
        return (self.status is not None and self.status_age <= settings.status_timeout and self.place_known
                and self.attitude_age <= settings.attitude_timeout and self.position_age <= settings.position_timeout)


@dataclass(frozen=True)
class Decision:
    """What is to be sent now.

    Parameters:
        heartbeat: OffboardControlMode
        setpoint: a trajectory setpoint that holds the position
        yaw_rate (rad/s): of that setpoint, counter-clockwise; 0 holds the heading
        reason: for the state
    """

    heartbeat: bool
    setpoint: bool
    yaw_rate: float
    reason: str


@dataclass
class BodyGuard:
    """The guard; `step` is to be called at 20 Hz or more.

    Parameters:
        settings: limits and timeouts
    """

    settings: GuardSettings = field(default_factory=GuardSettings)
    _rate: float = 0.0
    _time: float | None = None
    _resumed: float = -math.inf    # end of this process's last stall

    def step(self, time: float, inputs: Inputs) -> Decision:
        """Decide for `time` (s, monotonic). Steps back count as 0 s, long ones as 0.1 s."""
        dt = 0.0 if self._time is None else min(max(time - self._time, 0.0), 0.1)
        if self._time is not None and time - self._time > STALL:
            self._resumed = time
        self._time = time
        heartbeat = inputs.healthy(self.settings)
        forbidden = self._forbidden(time, inputs)
        if forbidden:
            self._rate = 0.0
            return Decision(heartbeat, False, 0.0, forbidden)
        halt = self._halt(inputs, armed=bool(inputs.status and inputs.status.armed))
        limit, change = self.settings.max_rate, self.settings.max_acceleration * dt
        wanted = 0.0 if halt else min(max(inputs.yaw_rate, -limit), limit)
        self._rate = min(max(wanted, self._rate - change), self._rate + change)
        return Decision(heartbeat, True, self._rate, halt or 'turning as commanded')

    def _forbidden(self, time: float, inputs: Inputs) -> str:
        """Reason why no setpoint may be sent, empty when one may."""
        status, settings = inputs.status, self.settings
        if status is None or not inputs.status_age <= settings.status_timeout:
            return 'no fresh vehicle_status'
        if time - inputs.status_age < self._resumed:
            return 'after a stall: waiting for the next vehicle_status'
        own = inputs.own_mode is not None and inputs.own_mode in EXTERNAL_MODES and status.nav_state == inputs.own_mode
        if status.nav_state != OFFBOARD and not own:
            return f'the pilot has not handed over (nav_state {status.nav_state})'
        if status.failsafe:
            return 'failsafe'
        return '' if inputs.place_known else 'no position to hold'

    def _halt(self, inputs: Inputs, armed: bool) -> str:
        """Reason why the vehicle must stand still, empty when it may turn."""
        settings = self.settings
        reasons = {
            'vehicle_status is overdue': not inputs.status_age <= settings.status_timeout - STOP_WITHIN,
            'not armed': not armed,
            'no fresh attitude': not inputs.attitude_age <= settings.attitude_timeout,
            'no fresh position': not inputs.position_age <= settings.position_timeout,
            'no fresh pointing command': not inputs.command_age <= settings.command_timeout,
            'no fresh bearing': not inputs.bearing_age <= settings.bearing_timeout,
            'commands are not acknowledged': inputs.unacknowledged,
            'the body is not to move': not inputs.move,
            'the yaw rate is no number': not math.isfinite(inputs.yaw_rate)}
        return next((reason for reason, holds in reasons.items() if holds), '')
