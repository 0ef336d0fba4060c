"""Guard of the body motion: the only code that decides whether a setpoint is sent, and with what yaw rate.

PX4 1.16 accepts setpoints over DDS in any mode, even Hold. A setpoint is therefore sent only while a fresh status reports
that the pilot has selected OFFBOARD or this rig's external mode. The guard can neither arm nor select a mode.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

OFFBOARD = 14                      # vehicle_status nav_state
EXTERNAL_MODES = range(23, 31)     # nav_state of external modes 1 to 8
STOP_WITHIN = 0.3                  # s from staleness to standstill; for command, measurement and attitude from their arrival
MARGIN = 0.05                      # s, part of STOP_WITHIN that is reserved for the period of the steps
SLOW_WITHIN = 0.15                 # s from the newest command or measurement, after which a fast body is driven no further
FAST = math.radians(15.0)          # rad/s, from which a body counts as fast: PX4 turns on by 0.5 s times its rate
STALL = 0.8                        # s between steps after which PX4 may have left OFFBOARD unnoticed (COM_OF_LOSS_T)


@dataclass(frozen=True)
class GuardSettings:
    """Limits of the motion, and the age since arrival at which each input becomes stale.

    `max_rate / max_acceleration` is the time to stop, at most 0.25 s. A status arrives twice a second; braking begins 0.3 s
    before it becomes stale, so that the last setpoint commands a yaw rate of 0. Raises ValueError for limits without time
    to stop.

    Parameters:
        max_rate (rad/s): maximum yaw rate
        max_acceleration (rad/s^2): maximum change of the yaw rate
        command_timeout (s): maximum age of the pointing command
        bearing_timeout (s): maximum age of the bearing's newest measurement
        attitude_timeout (s): maximum age of PX4's attitude
        position_timeout (s): maximum age of PX4's local position
        status_timeout (s): maximum age of PX4's vehicle_status
    """

    max_rate: float = math.radians(30.0)
    max_acceleration: float = math.radians(400.0)
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
    """The fields of px4_msgs/VehicleStatus that the guard needs.

    Parameters:
        nav_state: mode
        armed: whether the motors are armed
        failsafe: whether a failsafe of PX4 is active
        system_id: MAVLink id of the vehicle
    """

    nav_state: int
    armed: bool
    failsafe: bool
    system_id: int = 1


@dataclass(frozen=True)
class Inputs:
    """State of the vehicle and of the rig. Ages count from the arrival of new data; inf for an input that never arrived.

    Parameters:
        status: newest status, None before the first
        status_age (s): age of vehicle_status
        attitude_age (s): age of the attitude
        position_age (s): age of the local position
        command_age (s): age of the pointing command
        bearing_age (s): age of the bearing's newest measurement
        yaw_rate (rad/s): commanded yaw rate, counter-clockwise
        move: whether the body follows the yaw rate
        own_mode: nav_state of the rig's external mode while PX4 confirms it, else None
        place_known: whether a position to hold is known
        unacknowledged: whether acknowledgements of the gimbal commands have stopped
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

    def unable(self, settings: GuardSettings) -> str:
        """Why the vehicle cannot hold its position, so that PX4 takes over (COM_OF_LOSS_T, arming check); empty if it can."""
        reasons = {
            'no fresh vehicle_status': not (self.status and self.status_age <= settings.status_timeout),
            'no fresh attitude': not self.attitude_age <= settings.attitude_timeout,
            'no fresh position': not self.position_age <= settings.position_timeout,
            'no position to hold': not self.place_known}
        return next((reason for reason, holds in reasons.items() if holds), '')


@dataclass(frozen=True)
class Decision:
    """Result of one step of the guard.

    Parameters:
        heartbeat: whether OffboardControlMode is sent
        setpoint: whether a trajectory setpoint that holds the position is sent
        yaw_rate (rad/s): yaw rate of that setpoint, counter-clockwise; 0 holds the heading
        reason: explanation for `px4/state`
        withheld: why no heartbeat is sent, so that the pilot cannot select OFFBOARD; empty if it is
    """

    heartbeat: bool
    setpoint: bool
    yaw_rate: float
    reason: str
    withheld: str = ''


@dataclass
class BodyGuard:
    """The guard of the body motion. `step` must be called at 20 Hz or more.

    Parameters:
        settings: limits and timeouts
    """

    settings: GuardSettings = field(default_factory=GuardSettings)
    _rate: float = 0.0
    _time: float | None = None
    _resumed: float = -math.inf    # end of this process's last stall
    _oldest: float = math.inf      # age of command or measurement at the last step, of which the larger
    _driven: float = 0.0           # yaw rate since then of the largest magnitude

    def step(self, time: float, inputs: Inputs) -> Decision:
        """Decide what is sent. The interval since the last step is limited to 0..0.1 s.

        Parameters:
            time (s): current time, monotonic
            inputs: state of the vehicle and of the rig
        """
        dt = 0.0 if self._time is None else min(max(time - self._time, 0.0), 0.1)
        if self._time is not None and time - self._time > STALL:
            self._resumed = time
        self._time = time
        withheld = inputs.unable(self.settings)
        forbidden = self._forbidden(time, inputs)
        if forbidden:
            self._rate = 0.0
            return Decision(not withheld, False, 0.0, forbidden, withheld)
        halt = self._halt(inputs, armed=bool(inputs.status and inputs.status.armed))
        limit, change = self.settings.max_rate, self.settings.max_acceleration * dt
        wanted = 0.0 if halt else self._slowed(min(max(inputs.yaw_rate, -limit), limit), inputs)
        self._rate = min(max(wanted, self._rate - change), self._rate + change)
        # Braking begins so early that 0 is commanded STOP_WITHIN after the newest command, measurement or attitude.
        left = STOP_WITHIN - MARGIN - max(inputs.command_age, inputs.bearing_age, inputs.attitude_age)
        ceiling = self.settings.max_acceleration * max(left, 0.0)
        self._rate = min(max(self._rate, -ceiling), ceiling)
        return Decision(not withheld, True, self._rate, halt or 'turning as commanded', withheld)

    def _slowed(self, wanted: float, inputs: Inputs) -> float:
        """A yaw rate (rad/s), less where a fast body would be driven on with an old command or measurement.

        It may still be braked by the opposite rate, which pointing_node commands.
        """
        oldest = max(inputs.command_age, inputs.bearing_age)
        if oldest < self._oldest or abs(self._rate) > abs(self._driven):
            self._driven = self._rate
        self._oldest = oldest
        if abs(self._driven) < FAST or wanted * self._driven < 0.0:
            return wanted
        ceiling = self.settings.max_acceleration * max(SLOW_WITHIN - oldest, 0.0)
        return min(max(wanted, -ceiling), ceiling)

    def _forbidden(self, time: float, inputs: Inputs) -> str:
        """Reason why no setpoint may be sent, empty if one may."""
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
        """Reason why the yaw rate must be 0, empty if the vehicle may turn."""
        settings = self.settings
        reasons = {
            'vehicle_status is overdue': not inputs.status_age <= settings.status_timeout - STOP_WITHIN,
            'not armed': not armed,
            'no fresh attitude': not inputs.attitude_age <= settings.attitude_timeout,
            'no fresh position': not inputs.position_age <= settings.position_timeout,
            'no fresh pointing command': not inputs.command_age <= settings.command_timeout,
            'no fresh measurement': not inputs.bearing_age <= settings.bearing_timeout,
            'commands are not acknowledged': inputs.unacknowledged,
            'the body is not to move': not inputs.move,
            'the yaw rate is no number': not math.isfinite(inputs.yaw_rate)}
        return next((reason for reason, holds in reasons.items() if holds), '')
